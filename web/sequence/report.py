"""A label set's `report.json`, prepared for its page.

**Conventions.** Values missing in an older report are None or empty. Numbers are unchanged.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from api.files import StoredFile, read_whole
from services.runtime.store.protocol import Store
from stone_base.codes.catalogue import PROFILE_CODES
from stone_base.label_grid import PAPER

MOST_BYTES = 4_000_000
CLASS_KEYS = ("traversable", "potentially_traversable", "non_traversable")


@dataclass(frozen=True)
class ClockShift:
    """The seconds added to the times of a recording, their standard error, and their source."""

    name: str
    added_s: float
    error_ms: float | None
    known_by: str


@dataclass(frozen=True)
class HeldOutBand:
    """Judged voxels so far from the way that the reference knew, and the share of them that is T or P."""

    from_m: float
    to_m: float | None
    voxels: int
    recall: float


@dataclass(frozen=True)
class Report:
    """Facts by what people call them; `shares` are of T, P and N among occupied voxels.

    `held_out` is of both halves of the way together, without bands in which nothing was judged.

    `recordings` are those that were joined, each with what was added to its times: none of one alone.
    """

    profile: str
    grid: str
    pose_source: str
    excluded: int
    shares: tuple[float, float, float] | None
    observed_ratio: float | None
    map_voxels: int | None
    map_points: int | None
    findings: tuple[Mapping[str, str], ...]
    recordings: tuple[ClockShift, ...] = ()
    held_out: tuple[HeldOutBand, ...] = ()

    @property
    def is_solved_by_default_profile(self) -> bool:
        """Whether the labels are of profile paper and have a finding that the default profile solves."""
        return self.profile == "paper" and any(finding["code"] in PROFILE_CODES for finding in self.findings)


def read_report(store: Store, file: StoredFile | None) -> Report | None:
    """Return None if the labels have no report, or one of an impossible size. Raises `ObjectMissingError`."""
    if file is None or file.size_bytes > MOST_BYTES:
        return None
    return report_of(json.loads(read_whole(store, file)))


def report_of(record: Mapping[str, Any]) -> Report:
    """Return the report, with None for missing values."""
    parameters, shares = record.get("parameters") or {}, record.get("class_share_of_occupied")
    mapped, observed = record.get("map") or {}, record.get("observed_ratio") or {}
    return Report(
        profile=str(parameters.get("profile") or ""),
        grid=str((record.get("grid") or {}).get("name") or PAPER.name),
        pose_source=str(record.get("pose_source") or ""),
        excluded=len(record.get("excluded") or ()),
        shares=None if shares is None else tuple(float(shares[key]) for key in CLASS_KEYS),  # type: ignore[arg-type]
        observed_ratio=observed.get("lidar"),
        map_voxels=mapped.get("voxels"),
        map_points=mapped.get("points"),
        findings=tuple(record.get("findings") or ()),
        recordings=tuple(_shift(recording) for recording in record.get("recordings") or ()),
        held_out=_bands(record.get("held_out") or {}),
    )


def _bands(held_out: Mapping[str, Any]) -> tuple[HeldOutBand, ...]:
    halves = [half for half in (held_out.get("from_first_half"), held_out.get("from_second_half")) if half]
    shown = []
    for bands in zip(*(half["by_distance"] for half in halves), strict=True):
        voxels = sum(band["voxels"] for band in bands)
        if voxels:
            kept = sum(band["voxels"] * (band["recall"] or 0.0) for band in bands)
            shown.append(HeldOutBand(bands[0]["from_m"], bands[0]["to_m"], voxels, kept / voxels))
    return tuple(shown)


def _shift(one: Mapping[str, Any]) -> ClockShift:
    sigma_ns = one.get("sigma_ns")
    error_ms = None if sigma_ns is None else round(sigma_ns / 1e6, 2)
    return ClockShift(str(one["name"]), one["offset_ns"] / 1e9, error_ms, ", ".join(one.get("known_by") or ()))
