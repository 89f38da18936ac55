"""The labeler in the queue: the graph of `services/labeler/pipeline.py` as jobs, and its stages as handlers.

**Conventions.** A handler may run twice, concurrently or after being killed anywhere: files are renamed into place and
have the same bytes. Jobs contain only numbers; everything else is in the run's workspace. A handler pulls the files
that its stage reads, and pushes the files that it wrote. Only a sandboxed child opens files of the run
(`services/labeler/sandboxed_run.py`).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from services.domain.datasets.input_jobs import INPUTS
from services.domain.exports.requests import EXPORT
from services.domain.sequences.processing import CHECK, LABEL
from services.labeler.child_answers import FilesAnswer, GraphAnswer, JobAnswer, WorkAnswer
from services.labeler.export_stage import export, make_input
from services.labeler.imports.queue_handlers import import_handlers
from services.labeler.pipeline import PUBLISH, STAGES
from services.labeler.publication import publish
from services.labeler.run_workspace import LabelStageContext, stage_context_of
from services.labeler.sandboxed_run import StageTask, files_near, planned, worked
from services.labeler.spent_files import FREEING, delete_spent
from services.labeler.stage import Stage
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.platform import Platform
from services.runtime.telemetry.counters import FRAMES, process_counters


def handlers(platform: Platform) -> Handlers:
    """Return the stages by kind."""
    stages: dict[str, Callable[[LabelStageContext], Outcome]] = {
        LABEL: list_jobs,
        **{kind: partial(run_stage, kind, stage) for kind, stage in STAGES.items()},
        PUBLISH: publish,
    }
    made = {kind: partial(_with_context, platform, stage) for kind, stage in stages.items()}
    others = {EXPORT: partial(export, platform), INPUTS: partial(make_input, platform)}
    return {**made, **others, **import_handlers(platform)}


def list_jobs(context: LabelStageContext) -> Outcome:
    """Queue all jobs of the run; publishing also needs the checks of its sequence.

    If the recording is local, the child is given it and is kept for the first job, which reads sweeps. Raises
    `no_frames`, and what `LabelStageContext.ask` and `opening_with_sweeps` raise.
    """
    opening = context.opening_with_sweeps() if context.workspace.is_in_place else context.opening
    graph = context.ask(GraphAnswer, partial(planned, opening), "plan", opening)
    return Outcome({"parts": graph.parts, "tiles": graph.tiles}, then=tuple(_spec(job) for job in graph.jobs))


def _spec(job: JobAnswer) -> JobSpec:
    return replace(job.spec(), after=(CHECK,)) if job.kind == PUBLISH else job.spec()


def run_stage(kind: str, stage: Stage, context: LabelStageContext) -> Outcome:
    """Delete spent files, pull the job's inputs, do its work, and push its outputs.

    Raises what the work raises, and `work_gone`.
    """
    if kind in FREEING:
        delete_spent(context)
    opening = context.opening_with_sweeps() if stage.reads_sweeps else context.opening
    task = StageTask(opening, kind, context.attempt.arguments)
    near: tuple[str, ...] = ()
    if stage.list_near and not context.workspace.is_in_place:
        near = context.ask(FilesAnswer, partial(files_near, task), stage.step_name, context.opening).names
    context.pull((*stage.reads, *near), stage.requires)
    done = context.ask(WorkAnswer, partial(worked, task), stage.step_name, opening)
    context.workspace.push(*done.written)
    facts: dict[str, Any] = dict(done.facts)
    if facts:
        context.attempt.log(stage.event, **facts)
    if labelled := done.result.get("frames"):
        process_counters().add(FRAMES, ("labelled",), labelled)
    return Outcome(done.result)


def _with_context(platform: Platform, stage: Callable[[LabelStageContext], Outcome], attempt: Attempt) -> Outcome:
    return stage(stage_context_of(platform, attempt))
