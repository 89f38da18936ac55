"""Progress of a sequence's runs: each stage with its share done.

**Conventions.** A run grows while it goes: stages that it will have are shown before they stand in the queue, as far as
the order of stages is known here. Names are for people; the kinds of jobs are the runtime's.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from api.schemas.jobs import JobDetail, StageItem

TITLES: Mapping[str, str] = {
    "ingest.register": "Read the recording",
    "ingest.synchronise": "Synchronise sensors",
    "labeler.parts": "Plan the map",
    "labeler.fuse": "Fuse sweeps",
    "labeler.surface": "Reconstruct the surface",
    "labeler.sight": "See what is free",
    "labeler.reference": "Learn driven ground",
    "labeler.map": "Draw the map",
    "labeler.frames": "Label frames",
    "labeler.publish": "Publish",
    "labeler.export": "Write the export",
    "eval.compare": "Compare label sets",
    "ingest.keep_dataset": "Keep the dataset",
    "labeler.import_index": "Read its tables",
    "labeler.import_scene": "Import scenes",
    "labeler.import_publish": "Publish the dataset",
    "dataset.import": "Importing a dataset",
    "sequence.process": "Labelling",
}
OTHERS = ("labeler.export", "labeler.import")
LABELLING = tuple(kind for kind in TITLES if kind.startswith("labeler.") and not kind.startswith(OTHERS))
ORDER = tuple(TITLES)
PROCESS, SYNCHRONISE = "sequence.process", "ingest.synchronise"
ENDED = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class RunStep:
    """One stage; `state` is waiting, running, succeeded or failed."""

    kind: str
    title: str
    state: str
    done: int
    total: int


def title_of(kind: str) -> str:
    """The title of jobs of this kind."""
    return TITLES.get(kind, kind)


def steps_of(run: JobDetail) -> tuple[RunStep, ...]:
    """The stages of a run as they stand, and those that are to come while it may still reach them."""
    if run.queue:
        return (RunStep(run.kind, title_of(run.kind), _own_state(run.state), run.progress.done, run.progress.total),)
    steps = [RunStep(one.kind, title_of(one.kind), _state(one), one.done, one.total) for one in run.stages]
    if run.kind == PROCESS and run.state not in ENDED:
        known = {step.kind for step in steps}
        coming = [kind for kind in (SYNCHRONISE, *LABELLING) if kind not in known]
        steps += [RunStep(kind, title_of(kind), "waiting", 0, 0) for kind in coming]
    return tuple(sorted(steps, key=lambda step: ORDER.index(step.kind) if step.kind in ORDER else len(ORDER)))


def is_alive(run: JobDetail | None) -> bool:
    """Whether there is something to follow."""
    return run is not None and run.state not in ENDED


def _state(stage: StageItem) -> str:
    if stage.failed:
        return "failed"
    if stage.total and stage.done == stage.total:
        return "succeeded"
    return "running" if stage.running or stage.done else "waiting"


def _own_state(state: str) -> str:
    return "waiting" if state == "queued" else state
