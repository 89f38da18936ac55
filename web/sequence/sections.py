"""Responses for the sections of a sequence's page: the head that all share, and the section's own content."""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller, PlatformDep
from api.schemas.base import IdPath
from api.schemas.jobs import JobDetail, StageItem
from api.schemas.sequences.calibrations import CalibrationItem
from api.visible import theirs
from services.domain.sequences.label_sources import SOURCE_INDEX
from services.runtime.jobs.queries import TITLES, title_of
from services.runtime.orm import CalibrationRow
from stone.splits.surroundings import ILLUMINATIONS, OFFERED
from web.rendering import page
from web.sequence.status import SequenceStatus

MOST_CALIBRATIONS = 200


@dataclass(frozen=True)
class Visit:
    """Which sequence is visited, on which platform."""

    request: Request
    sequence_id: IdPath
    platform: PlatformDep


AtSequence = Annotated[Visit, Depends(Visit)]


def shown_section(
    at: Visit, looking: tuple[Caller, SequenceStatus], name: str, *, needs_wasm: bool = False, **values: Any
) -> HTMLResponse:
    """Return the section called `name` for a caller and a status; `needs_wasm` if bags are uploaded there."""
    caller, standing = looking
    shown = standing.sequence
    head: dict[str, Any] = {
        "standing": standing,
        "sequence": shown,
        "section": "" if name == "overview" else f"/{name}",
        "base": f"/sequences/{shown.id}",
        "api": f"/api/v1/sequences/{shown.id}",
        "is_imported": any(file.name == SOURCE_INDEX for file in shown.artefacts),
        "pictures": {file.name for file in shown.artefacts} | {file.name for file in shown.previews},
        "steps": steps_of(standing.run) if standing.run else (),
        "title_of": title_of,
        "environments": OFFERED,
        "roots": at.platform.settings.in_place.roots,
        "illuminations": ILLUMINATIONS,
    }
    return page(at.request, caller, f"sequence/{name}.html", needs_wasm=needs_wasm, **head | values)


def choosable(session: Session, caller: Caller, standing: SequenceStatus) -> list[CalibrationItem]:
    """Return the calibrations that a caller who may change the sequence can assign, newest first; none for others."""
    if not standing.may_change:
        return []
    mine = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id).order_by(CalibrationRow.id.desc())
    return [CalibrationItem.of(row) for row in session.scalars(mine.limit(MOST_CALIBRATIONS))]


# Progress of a sequence's runs: each stage with its share done and its duration.
#
# **Conventions.** A run gets stages while it runs: later stages are shown before they are queued, as far as their order
# is known here. In an ended run, unfinished stages were stopped.


OTHERS = ("labeler.export", "labeler.import", "labeler.inputs")
LABELLING = tuple(kind for kind in TITLES if kind.startswith("labeler.") and not kind.startswith(OTHERS))
ORDER = tuple(TITLES)
PROCESS, SYNCHRONISE, CHECK = "sequence.process", "ingest.synchronise", "ingest.check"
ENDED = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class RunStep:
    """One stage; `state` is waiting, running, succeeded, failed or cancelled.

    `lasted_s` is from the beginning of its first job to the end of its last; None while it is not over.
    """

    kind: str
    title: str
    state: str
    done: int
    total: int
    lasted_s: float | None = None


def steps_of(run: JobDetail) -> tuple[RunStep, ...]:
    """Return the stages of a run, including later ones that a live run may still reach."""
    if run.queue:
        return (RunStep(run.kind, title_of(run.kind), _own_state(run.state), run.progress.done, run.progress.total),)
    is_over = run.state in ENDED
    steps = [_step(stage, is_over) for stage in run.stages]
    if run.kind == PROCESS and not is_over:
        known = {step.kind for step in steps}
        coming = [kind for kind in (SYNCHRONISE, CHECK, *LABELLING) if kind not in known]
        steps += [RunStep(kind, title_of(kind), "waiting", 0, 0) for kind in coming]
    return tuple(sorted(steps, key=lambda step: ORDER.index(step.kind) if step.kind in ORDER else len(ORDER)))


def _step(stage: StageItem, is_over: bool) -> RunStep:
    state = _state(stage, is_over)
    lasted = stage.ended_at - stage.began_at if stage.began_at and stage.ended_at and state != "running" else None
    lasted_s = lasted.total_seconds() if lasted is not None else None
    return RunStep(stage.kind, stage.title, state, stage.done, stage.total, lasted_s)


def _state(stage: StageItem, is_over: bool) -> str:
    if stage.failed:
        return "failed"
    if stage.total and stage.done == stage.total:
        return "succeeded"
    if is_over:
        return "cancelled"
    return "running" if stage.running or stage.done else "waiting"


def _own_state(state: str) -> str:
    return "waiting" if state == "queued" else state
