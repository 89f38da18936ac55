"""The request of the run that made the labels, to repeat it with another profile.

**Conventions.** Only the profile changes; topics, parameters, grid, ground, chosen recordings and clock offsets stay.
The calibration is the one assigned to the sequence.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from sqlalchemy.orm import Session

from services.domain.sequences.processing import GIVEN_GROUND, PROCESS, ProcessRequest, request_of
from services.runtime.orm import Job, LabelSet
from stone_base.counts import counted
from stone_base.label_grid import GRIDS, PAPER


@dataclass(frozen=True)
class RunChoices:
    """Values for the form: `kept` are those that it has no fields for, as the API's body has them, and in words."""

    profile: str
    odometry_topic: str
    lidar_topic: str
    parameters: Mapping[str, float]
    grid: str
    kept: Mapping[str, Any]
    kept_words: tuple[str, ...]

    @property
    def body(self) -> dict[str, Any]:
        """Return the request to process with these choices, as the API accepts it."""
        topics = {"odometry_topic": self.odometry_topic, "lidar_topic": self.lidar_topic}
        grid = {"grid": self.grid} if self.grid in GRIDS else {}
        chosen = {"profile": self.profile, "parameters": dict(self.parameters), **grid}
        return {**{key: topic for key, topic in topics.items() if topic}, **chosen, **self.kept}

    @property
    def has_details(self) -> bool:
        """Whether a field in the folded details is filled in."""
        return bool(self.odometry_topic or self.lidar_topic or self.parameters or self.grid != PAPER.name)


def choices_of(session: Session, labels: LabelSet | None, profile: str = "") -> RunChoices | None:
    """Return the request of the run of these labels, with this profile or its own; None for labels without a run."""
    run = None if labels is None or labels.job_id is None else session.get(Job, labels.job_id)
    if run is None or run.kind != PROCESS or "profile" not in run.arguments:
        return None
    request = request_of(run.arguments)
    return RunChoices(
        profile=profile or request.profile,
        odometry_topic=request.odometry_topic or "",
        lidar_topic=request.lidar_topic or "",
        parameters=dict(request.parameters),
        grid=request.grid.name,
        kept=_kept(request),
        kept_words=_words(request),
    )


def _kept(asked: ProcessRequest) -> dict[str, Any]:
    offsets_s = {name: str(Decimal(offset_ns).scaleb(-9)) for name, offset_ns in asked.clock_offsets_ns.items()}
    return {
        "ground": asked.ground,
        "recording_ids": list(asked.recording_ids),
        "clock_offsets_s": offsets_s,
        **({} if asked.grid.name in GRIDS else {"grid": asked.grid.as_record()}),
    }


def _words(asked: ProcessRequest) -> tuple[str, ...]:
    ground = () if asked.ground == GIVEN_GROUND else (f"ground {asked.ground}",)
    chosen = (counted(len(asked.recording_ids), "chosen recording"),) if asked.recording_ids else ()
    offsets = (f"{name} {ns / 1e9:+.6f} s" for name, ns in sorted(asked.clock_offsets_ns.items()))
    return (*ground, *chosen, *offsets)
