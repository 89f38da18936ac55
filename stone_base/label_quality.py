"""The quality of a label set in two figures: its held-out recall, and its most harmful finding.

**Conventions.** `report.json` of the set contains both figures. None means unknown: the labels were imported or made by
an earlier version, or the track is too short.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from stone_base.codes.catalogue import harm_of, harm_rank
from stone_base.codes.meaning import Harm


@dataclass(frozen=True)
class GravestFinding:
    """The code of a finding, and its effect on labels."""

    code: str
    harm: Harm


@dataclass(frozen=True)
class LabelQuality:
    """The held-out recall and the most harmful finding of a label set.

    `held_out_recall`: share of the driven ground, in the half of the track hidden from the reference, that is labelled
    T or P. `held_out_m`: length of the judged track in metres. `gravest_code`: None if no finding is harmful, or none
    is known.
    """

    held_out_recall: float | None = None
    held_out_m: float | None = None
    gravest_code: str | None = None
    gravest_severity: str | None = None

    @property
    def gravest(self) -> GravestFinding | None:
        """The most harmful finding, or None if its code does no harm or is not in the catalogue."""
        if self.gravest_code is None or self.gravest_severity is None:
            return None
        harm = harm_of(self.gravest_code, self.gravest_severity)
        return None if harm is None or harm == "none" else GravestFinding(self.gravest_code, harm)

    def as_record(self) -> dict[str, Any]:
        """Return the figures in the form of API responses, manifests and exports."""
        gravest = self.gravest
        return {
            "held_out_recall": self.held_out_recall,
            "held_out_m": self.held_out_m,
            "gravest": None if gravest is None else {"code": gravest.code, "harm": gravest.harm},
        }


UNKNOWN = LabelQuality()


def quality_of(report: Mapping[str, Any]) -> LabelQuality:
    """Return the quality in a `report.json`; reports of older versions and of imported labels lack parts."""
    held = report.get("held_out") or {}
    recall = held.get("recall")
    qualities = (
        LabelQuality(None, None, finding["code"], finding["severity"]) for finding in report.get("findings") or ()
    )
    judged_m = None if recall is None else held.get("judged_m")
    return replace(gravest_of(qualities), held_out_recall=recall, held_out_m=judged_m)


def gravest_of(qualities: Iterable[LabelQuality]) -> LabelQuality:
    """Return the most harmful finding (the first of equals) as a quality without a recall."""
    harmed = [
        (quality.gravest_code, quality.gravest_severity)
        for quality in qualities
        if quality.gravest_code and quality.gravest_severity and quality.gravest
    ]
    if not harmed:
        return UNKNOWN
    code, severity = min(harmed, key=lambda pair: harm_rank(*pair))
    return LabelQuality(gravest_code=code, gravest_severity=severity)


def pooled(qualities: Iterable[LabelQuality]) -> LabelQuality:
    """Return the recall over the judged metres of all label sets, and their most harmful finding."""
    rows = list(qualities)
    judged = [(quality.held_out_recall, quality.held_out_m) for quality in rows]
    known = [(recall, judged_m) for recall, judged_m in judged if recall is not None and judged_m]
    total_m = sum(judged_m for _, judged_m in known)
    if not total_m:
        return gravest_of(rows)
    recall = sum(recall * judged_m for recall, judged_m in known) / total_m
    return replace(gravest_of(rows), held_out_recall=round(recall, 4), held_out_m=round(total_m, 1))
