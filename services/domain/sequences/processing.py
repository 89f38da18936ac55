"""Processing of a sequence: register recordings, run the pipeline, delete.

**Conventions.** Each function is part of the caller's transaction and locks the sequence's row first, then the rows of
runs. A stage that ends locks only its run. The services' stages do the work; this module refers to them only by kind.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from services.domain.sequences.chosen_recordings import chosen_recordings, offsets_by_name
from services.domain.sequences.label_choices import DEFAULT_PROFILE, check_choices
from services.domain.sequences.processing_errors import (
    AlreadyProcessingError,
    RecordingPendingError,
    SequenceDeletedError,
)
from services.domain.sequences.profiles import topics_of
from services.runtime.access import storage_quota
from services.runtime.code_version import code_version
from services.runtime.jobs.control import cancel
from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL, Context, JobSpec
from services.runtime.orm import (
    CalibrationRow,
    Export,
    Job,
    LabelComparison,
    LabelSet,
    Preview,
    Recording,
    RecordingFile,
    SequenceRow,
)
from services.runtime.orm.base import now_ns
from services.runtime.store.recipes import recipe_of
from services.runtime.telemetry.tracing import link_uploads_of
from stone.errors import Refused
from stone_base.label_grid import PAPER, LabelGrid, record_unless_paper, recorded_grid

PROCESS = "sequence.process"
REGISTER = "ingest.register"
SYNCHRONISE = "ingest.synchronise"
CHECK = "ingest.check"
LABEL = "labeler.parts"
STAGES = ("synchronise", "label")
GIVEN_GROUND = "given"
ALIVE = Job.state.not_in(TERMINAL)


@dataclass(frozen=True)
class ProcessRequest:
    """Choices for processing a sequence.

    - `parameters`: by dotted name (bounds in `label_choices.py`)
    - `topics`: from the platform's profile; `odometry_topic` and `lidar_topic` take precedence
    - `ground`: "given" by the calibration, or "auto": measure the height of the LiDAR's mount, and a tilt beyond
      terrain's
    - `recording_ids`: default: all registered recordings, also later ones
    - `clock_offsets_ns`: by id or name of recording; they replace measured offsets
    """

    profile: str = DEFAULT_PROFILE
    parameters: Mapping[str, float] = field(default_factory=dict)
    odometry_topic: str | None = None
    lidar_topic: str | None = None
    stages: tuple[str, ...] = STAGES
    topics: Mapping[str, str] = field(default_factory=dict)
    ground: str = GIVEN_GROUND
    recording_ids: tuple[str, ...] = ()
    clock_offsets_ns: Mapping[str, int] = field(default_factory=dict)
    grid: LabelGrid = PAPER


@dataclass(frozen=True)
class Ingredients:
    """The inputs of a sequence's labels; `offsets_ns` by name of recording."""

    calibration: CalibrationRow
    recordings: tuple[Recording, ...]
    offsets_ns: Mapping[str, int]


def register(session: Session, recording: Recording) -> Job:
    """Queue the job that reads and stores a received recording. Raises `SequenceDeletedError`, `QueueDrainingError`."""
    sequence = lock_sequence(session, recording.sequence_id)
    return enqueue(session, JobSpec(REGISTER, {"recording_id": recording.id}), _context(sequence))


def start_processing(session: Session, sequence: SequenceRow, request: ProcessRequest) -> Job:
    """Return the run for this request: a new run, the current one, or one that has already succeeded.

    Raises `bad_parameter`, `bad_stages`, `SequenceDeletedError`, `no_calibration`, `no_recording`,
    `RecordingPendingError`, `unknown_recording`, `recordings_named_alike`, `bad_clock_offset`,
    `AlreadyProcessingError`, `QueueDrainingError`.
    """
    check_choices(request.profile, request.parameters)
    if not request.stages or request.stages != STAGES[: len(request.stages)]:
        raise unknown_stages(request.stages, STAGES)
    sequence = lock_sequence(session, sequence.id)
    inputs = checked_inputs(session, sequence, request)
    request = replace(request, topics=topics_of(session, sequence))
    for recording in inputs.recordings:
        link_uploads_of(session, recording.id)
    arguments, recipe = _arguments(request, inputs), _recipe(sequence, request, inputs)
    standing = _existing_run(session, sequence, recipe)
    if standing is not None:
        return standing
    specs = [JobSpec(SYNCHRONISE, {**arguments, "recipe": recipe})]
    run = enqueue_run(session, PROCESS, specs, _context(sequence))
    run.arguments = {**arguments, "recipe": recipe}
    return run


def delete_sequence(session: Session, sequence: SequenceRow) -> None:
    """Delete the sequence: cancel its jobs and delete its recordings, label sets and exports.

    The row stays for jobs that refer to it. Unreferenced blobs are collected later. Raises `SequenceDeletedError`.
    """
    sequence = lock_sequence(session, sequence.id)
    alive = select(Job.id).where(Job.sequence_id == sequence.id, Job.id == Job.root_id, ALIVE)
    for root_id in session.scalars(alive).all():
        with suppress(JobStateError):  # the job ended while this transaction waited for its row
            cancel(session, root_id, "its sequence was deleted")
    session.execute(delete(Preview).where(Preview.sequence_id == sequence.id))
    held = select(RecordingFile.upload_id).join(Recording).where(Recording.sequence_id == sequence.id)
    exports = select(Export.id).where(Export.sequence_id == sequence.id)
    recordings = select(Recording.id).where(Recording.sequence_id == sequence.id)
    comparisons = select(LabelComparison.id).where(LabelComparison.sequence_id == sequence.id)
    counted = (held, recordings, exports, comparisons)
    subjects = [sequence.id, *(subject for rows in counted for subject in session.scalars(rows))]
    session.execute(delete(Export).where(Export.sequence_id == sequence.id))
    session.execute(delete(Recording).where(Recording.sequence_id == sequence.id))
    storage_quota.lock_owner(session, sequence.owner_id)  # lock recordings before their owner's quota, as everywhere
    subjects += session.scalars(delete(LabelSet).where(LabelSet.sequence_id == sequence.id).returning(LabelSet.id))
    for subject_id in subjects:
        storage_quota.release(session, subject_id or "", "sequence deleted")
    sequence.deleted_ns = now_ns()
    sequence.revision += 1


def lock_sequence(session: Session, sequence_id: str) -> SequenceRow:
    """Return the sequence's row, locked until the end of the transaction. Raises `SequenceDeletedError`.

    The weak lock allows inserts of rows that refer to the sequence, which prevents deadlocks.
    """
    locked = select(SequenceRow).where(SequenceRow.id == sequence_id).with_for_update(key_share=True)
    sequence = session.scalars(locked.execution_options(populate_existing=True)).one()
    if sequence.deleted_ns is not None:
        raise SequenceDeletedError(sequence_id)
    return sequence


def pending_recordings(session: Session, sequence: SequenceRow) -> int:
    """Return the number of its recordings that are still being read."""
    pending = select(func.count()).where(Job.sequence_id == sequence.id, Job.kind == REGISTER, ALIVE)
    return session.scalar(pending) or 0


def _context(sequence: SequenceRow) -> Context:
    return Context(sequence.owner_id, sequence.id)


def checked_inputs(session: Session, sequence: SequenceRow, request: ProcessRequest) -> Ingredients:
    """Return the sequence's calibration and the requested recordings. Raises as `start_processing`."""
    if sequence.calibration_id is None:
        raise Refused("no_calibration", f"sequence {sequence.id} has no calibration; assign a calibration first")
    if count := pending_recordings(session, sequence):
        raise RecordingPendingError(sequence.id, count)
    recordings = chosen_recordings(session, sequence, request.recording_ids)
    offsets_ns = offsets_by_name(recordings, request.clock_offsets_ns)
    return Ingredients(session.get_one(CalibrationRow, sequence.calibration_id), recordings, offsets_ns)


def _arguments(request: ProcessRequest, inputs: Ingredients) -> dict[str, Any]:
    return {
        "recording_ids": [recording.id for recording in inputs.recordings],
        "recording_sha256s": [recording.sha256 for recording in inputs.recordings],
        "names_recordings": bool(request.recording_ids),
        "clock_offsets_ns": dict(inputs.offsets_ns),
        "calibration_id": inputs.calibration.id,
        "odometry_topic": request.odometry_topic,
        "lidar_topic": request.lidar_topic,
        "topics": dict(request.topics),
        "ground": request.ground,
        "profile": request.profile,
        "parameters": dict(request.parameters),
        "stages": list(request.stages),
        "code_version": code_version("labels"),
        **_grid_record(request),
    }


def _grid_record(request: ProcessRequest) -> dict[str, Any]:
    """Return the grid's record, {} for the paper's grid, so that requests of earlier versions stay equal."""
    record = record_unless_paper(request.grid)
    return {} if record is None else {"grid": record}


def request_of(arguments: Mapping[str, Any]) -> ProcessRequest:
    """Return the request of a run with these arguments. Topics come from the platform's current profile."""
    return ProcessRequest(
        profile=arguments["profile"],
        parameters=arguments["parameters"],
        odometry_topic=arguments["odometry_topic"],
        lidar_topic=arguments["lidar_topic"],
        stages=tuple(arguments.get("stages", STAGES)),
        ground=arguments.get("ground", GIVEN_GROUND),
        recording_ids=tuple(arguments["recording_ids"]) if arguments.get("names_recordings") else (),
        clock_offsets_ns=arguments.get("clock_offsets_ns", {}),
        grid=recorded_grid(arguments.get("grid")),
    )


def _recipe(sequence: SequenceRow, request: ProcessRequest, inputs: Ingredients) -> str:
    """Return the recipe by names and content, not by id: the same bag uploaded again gives the same recipe."""
    calibration = inputs.calibration
    return recipe_of(
        "labels",
        {
            "sequence": sequence.name,
            "recordings": sorted([recording.filename, recording.sha256] for recording in inputs.recordings),
            **({"clock_offsets_ns": dict(inputs.offsets_ns)} if inputs.offsets_ns else {}),
            "calibration": [calibration.filename, calibration.sha256],
            "odometry_topic": request.odometry_topic,
            "lidar_topic": request.lidar_topic,
            **({"topics": dict(request.topics)} if request.topics else {}),
            **({"ground": request.ground} if request.ground != GIVEN_GROUND else {}),
            "profile": request.profile,
            "parameters": {name: float(value) for name, value in request.parameters.items()},
            "stages": request.stages,
            **_grid_record(request),
        },
    )


def _existing_run(session: Session, sequence: SequenceRow, recipe: str) -> Job | None:
    """Return the finished or current run with this recipe. Raises `AlreadyProcessingError` for another recipe."""
    made = select(LabelSet).where(LabelSet.sequence_id == sequence.id, LabelSet.recipe == recipe)
    label_set = session.scalar(made)
    if label_set is not None:
        label_set.chosen_ns = now_ns()
        return session.get_one(Job, label_set.job_id)
    runs = select(Job).where(Job.sequence_id == sequence.id, Job.kind == PROCESS, ALIVE)
    for run in session.scalars(runs.execution_options(populate_existing=True)):
        if run.arguments["recipe"] != recipe or run.cancel_reason:
            raise AlreadyProcessingError(sequence.id, run.id)
        return run
    return None


def unknown_stages(stages: tuple[str, ...], known: tuple[str, ...]) -> Refused:
    requested = ", ".join(stages)[:120] or "none"
    return Refused("bad_stages", f"stages {requested} cannot be run; request {known[0]}, or {' and '.join(known)}")
