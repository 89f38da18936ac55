"""What the labeler does in the queue: the graph of `services/labeler/pipeline.py` as jobs, and its stages as handlers.

**Conventions.** A handler may run twice, at once or after being killed anywhere: files are renamed into place and have
the same bytes. Jobs carry numbers only; everything else lies in the run's workspace, of which a handler pulls what its
stage reads and pushes what it leaves.
"""

from collections.abc import Callable
from functools import partial

from services.domain.benchmarks.phases.inputs import INPUTS
from services.domain.exports.requests import EXPORT
from services.domain.sequences.processing import LABEL
from services.labeler.errors import NoUsableFramesError
from services.labeler.export_stage import export
from services.labeler.phase_inputs import make_input
from services.labeler.pipeline import FUSE, PUBLISH, STAGES, SURFACE, label_graph
from services.labeler.publication import publish
from services.labeler.stage import Stage
from services.labeler.stage_context import LabelStageContext, stage_context_of
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.platform import Platform
from services.runtime.telemetry.counters import process_counters
from services.runtime.telemetry.metric_names import FRAMES


def handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    stages: dict[str, Callable[[LabelStageContext], Outcome]] = {
        LABEL: list_jobs,
        **{kind: partial(run_stage, stage) for kind, stage in STAGES.items()},
        PUBLISH: publish,
    }
    made = {kind: partial(_with_context, platform, stage) for kind, stage in stages.items()}
    return {**made, EXPORT: partial(export, platform), INPUTS: partial(make_input, platform)}


def list_jobs(context: LabelStageContext) -> Outcome:
    """All the jobs of the run. Raises `NoUsableFramesError`."""
    if len(context.run.sequence.frames) == 0:
        raise NoUsableFramesError(context.run.sequence)
    jobs = label_graph(context.run)
    parts, tiles = (sum(job.kind == kind for job in jobs) for kind in (FUSE, SURFACE))
    return Outcome({"parts": parts, "tiles": tiles}, then=jobs)


def run_stage(stage: Stage, context: LabelStageContext) -> Outcome:
    """Pull what the job reads, do its work, push what it leaves. Raises what the work raises, and `WorkGoneError`."""
    arguments = context.attempt.arguments
    files = stage.files(context.run, arguments)
    context.pull(files)
    done = stage.work(context.run, arguments, context.step(stage.step_name))
    context.push(files)
    if done.facts:
        context.attempt.log(stage.event, **done.facts)
    if labelled := done.result.get("frames"):
        process_counters().add(FRAMES, ("labelled",), labelled)
    return Outcome(done.result)


def _with_context(platform: Platform, stage: Callable[[LabelStageContext], Outcome], attempt: Attempt) -> Outcome:
    return stage(stage_context_of(platform, attempt))
