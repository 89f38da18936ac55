"""Progress of a sequence's runs: each stage with its share done and how long it took.

**Conventions.** A run grows while it goes: stages that it will have are shown before they stand in the queue, as far as
the order of stages is known here. A stage of a run that has ended does not run: what was not done of it was stopped.
"""

from dataclasses import dataclass

from api.schemas.jobs import JobDetail, StageItem
from services.runtime.jobs.queries import TITLES, title_of

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
    """The stages of a run as they stand, and those that are to come while it may still reach them."""
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
