"""Phase inputs: the sensor data of a phase's sequences, made by jobs and served for download.

**Conventions.** An input is made of the synchronised sequence and the recording that the dataset version was made of,
once per sequence and phase, and never changes; its bytes are held by foreign keys to blobs, so it stays when the
sequence is deleted. Nothing of it comes from a label, so it may be read by whoever may read. Whoever adds to a phase
locks its row.
"""

from collections.abc import Sequence as Listing
from dataclasses import dataclass

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import TERMINAL, Attempt, Context, JobSpec
from services.runtime.orm import (
    Artefact,
    Blob,
    DatasetMember,
    Job,
    Phase,
    PhaseInput,
    PhaseInputPack,
    Recording,
    SequenceRow,
)
from services.runtime.store.blobs import PreparedBlob, link_all
from services.runtime.store.pack_archive import ExportLocation
from services.runtime.store.packs import PackedFiles
from stone.errors import StoneError

INPUTS = "labeler.inputs"
RUN = "phase.inputs"


class InputsStandError(StoneError):
    """Every sequence of the phase has its inputs already."""

    code = "inputs_stand"

    def __init__(self, phase: str, count: int) -> None:
        super().__init__(f"the inputs of all {count} sequences of phase {phase!r} are there; they never change")


class InputsImpossibleError(StoneError):
    """A sequence is gone, or what its inputs are made of."""

    code = "inputs_impossible"

    def __init__(self, names: Listing[str]) -> None:
        shown = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
        super().__init__(
            f"{len(names)} sequences have lost their recording or were deleted: {shown}; upload them again, or "
            "publish a dataset version without them"
        )


@dataclass(frozen=True, eq=False)
class PhaseInputResult:
    """The product of an input job for sequence `name`: stored blobs, and size and sha256 of the tar of the files."""

    name: str
    files: PackedFiles
    index: PreparedBlob
    packs: Listing[PreparedBlob]
    tar: tuple[int, str]


def start_inputs(session: Session, phase: Phase, user_id: str) -> Job:
    """The run that makes what is missing: the one that is at it, or a new one with a job for each sequence.

    Raises `InputsStandError`, `InputsImpossibleError`, `QueueDrainingError`.
    """
    phase = lock_phase(session, phase.id)
    runs = select(Job).where(Job.kind == RUN, Job.state.not_in(TERMINAL))
    for run in session.scalars(runs.execution_options(populate_existing=True)):
        if run.arguments["phase_id"] == phase.id and not run.cancel_reason:
            return run
    members = session.scalars(_members(phase)).all()
    there = set(session.scalars(select(PhaseInput.name).where(PhaseInput.phase_id == phase.id)))
    missing = [member for member in members if member.name not in there]
    if not missing:
        raise InputsStandError(phase.name, len(members))
    if lost := [member.name for member in missing if not _is_possible(session, member)]:
        raise InputsImpossibleError(lost)
    run = enqueue_run(session, RUN, [_spec(phase, member) for member in missing], Context(user_id))
    run.arguments = {"phase_id": phase.id}
    return run


def write_input(session: Session, attempt: Attempt, made: PhaseInputResult) -> None:
    """Write down what a job has made, in the transaction of its success; what stands already stays.

    Raises `JobCancelledError` when the phase was deleted.
    """
    phase = phase_of_attempt(session, attempt)
    if session.get(PhaseInput, (phase.id, made.name)) is not None:
        return
    link_all(session, (made.index, *made.packs))
    row = PhaseInput(phase_id=phase.id, name=made.name, index_sha256=made.index.sha256, files=len(made.files))
    row.size_bytes = int(made.files.sizes_bytes.sum())
    row.tar_bytes, row.tar_sha256 = made.tar
    session.add(row)
    session.flush()
    for ordinal, pack in enumerate(made.packs):
        session.add(PhaseInputPack(phase_id=phase.id, name=made.name, ordinal=ordinal, blob_sha256=pack.sha256))


def phase_of_attempt(session: Session, attempt: Attempt) -> Phase:
    """The phase the attempt works for, its row locked. Raises `JobCancelledError` when it was deleted."""
    wanted = select(Phase).where(Phase.id == attempt.arguments["phase_id"]).with_for_update(key_share=True)
    phase = session.scalars(wanted).one_or_none()
    if phase is None:
        raise JobCancelledError("its phase was deleted")
    return phase


def sequence_key(session: Session, attempt: Attempt) -> str:
    """The object that holds the synchronised sequence the attempt works for. Raises `InputsImpossibleError`."""
    found = _artefact(attempt.arguments["label_set_id"])
    key = session.scalar(select(Blob.object_key).where(Blob.sha256.in_(found.with_only_columns(Artefact.blob_sha256))))
    if key is None:
        raise InputsImpossibleError([attempt.arguments["name"]])
    return key


def inputs_of(phase_id: str) -> Select[PhaseInput]:
    return select(PhaseInput).where(PhaseInput.phase_id == phase_id)


def locate_input(session: Session, row: PhaseInput) -> ExportLocation:
    """The places of an input's files."""
    packs = select(Blob.object_key).join(PhaseInputPack, PhaseInputPack.blob_sha256 == Blob.sha256)
    own = packs.where(PhaseInputPack.phase_id == row.phase_id, PhaseInputPack.name == row.name)
    index = session.get_one(Blob, row.index_sha256)
    return ExportLocation(index.object_key, tuple(session.scalars(own.order_by(PhaseInputPack.ordinal))))


def _members(phase: Phase) -> Select[DatasetMember]:
    in_version = select(DatasetMember).where(DatasetMember.dataset_id == phase.dataset_id)
    return in_version.where(DatasetMember.part == phase.part).order_by(DatasetMember.name)


def _spec(phase: Phase, member: DatasetMember) -> JobSpec:
    at = {"phase_id": phase.id, "name": member.name}
    return JobSpec(INPUTS, {**at, "sequence_id": member.sequence_id, "label_set_id": member.label_set_id})


def _is_possible(session: Session, member: DatasetMember) -> bool:
    """Whether sequence, synchronised frames and a recording are still there."""
    sequence = session.get(SequenceRow, member.sequence_id)
    recorded = select(Recording.id).where(Recording.sequence_id == member.sequence_id, Recording.state == "registered")
    parts = (session.scalar(_artefact(member.label_set_id)), session.scalar(recorded.limit(1)))
    return sequence is not None and sequence.deleted_ns is None and None not in parts


def _artefact(label_set_id: str) -> Select[str]:
    return select(Artefact.id).where(Artefact.label_set_id == label_set_id, Artefact.name == SEQUENCE_FILE)
