"""Inputs: the sensor data of a sequence of a version, made by a job; for a phase or for the version itself.

**Conventions.** An input is made of the synchronised sequence that the version was published with and of what was
measured (`services/domain/sequences/label_sources.py`).
Of labels, mesh and report nothing is located: it may be read by whoever may read. What it is made for, its holder, is
named in the job's arguments. It is never made anew, so a member that lost its recording before has none for good.
"""

from collections.abc import Mapping
from collections.abc import Sequence as Listing
from dataclasses import dataclass

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.domain.sequences.label_sources import has_samples
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.runtime.jobs.specs import TERMINAL, Attempt, JobSpec
from services.runtime.orm import (
    Artefact,
    Blob,
    DatasetInput,
    DatasetInputPack,
    DatasetMember,
    Job,
    PhaseInput,
    PhaseInputPack,
    SequenceRow,
)
from services.runtime.store.blobs import PreparedBlob, link_all
from services.runtime.store.packs import PackedFiles
from stone.errors import StoneError

INPUTS = "labeler.inputs"


class InputsStandError(StoneError):
    """Every sequence has its inputs already."""

    code = "inputs_stand"

    def __init__(self, holder: str, count: int) -> None:
        super().__init__(f"the inputs of all {count} sequences of {holder} are there; they never change")


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
class InputResult:
    """The product of an input job for sequence `name`: stored blobs, and size and sha256 of the tar of the files."""

    name: str
    files: PackedFiles
    index: PreparedBlob
    packs: Listing[PreparedBlob]
    tar: tuple[int, str]


def add_input(
    session: Session,
    made: InputResult,
    row: DatasetInput | PhaseInput,
    packs: Listing[DatasetInputPack] | Listing[PhaseInputPack],
) -> None:
    """Write down what a job has made as this row and its packs', which name the holder; blobs are linked."""
    link_all(session, (made.index, *made.packs))
    row.index_sha256, row.files = made.index.sha256, len(made.files)
    row.size_bytes = int(made.files.sizes_bytes.sum())
    row.tar_bytes, row.tar_sha256 = made.tar
    session.add(row)
    session.flush()
    session.add_all(packs)


def members_of(dataset_id: str, parts: Listing[str]) -> Select[DatasetMember]:
    """The sequences of these parts of a version, by name."""
    in_version = select(DatasetMember).where(DatasetMember.dataset_id == dataset_id)
    return in_version.where(DatasetMember.part.in_(parts)).order_by(DatasetMember.name)


def input_spec(holder: Mapping[str, str], member: DatasetMember) -> JobSpec:
    """The job that makes the member's input for its holder."""
    of = {"name": member.name, "sequence_id": member.sequence_id, "label_set_id": member.label_set_id}
    return JobSpec(INPUTS, {**holder, **of})


def run_under_way(session: Session, kind: str, holder: Mapping[str, str]) -> Job | None:
    """The run that makes inputs for this holder; none that is being cancelled."""
    runs = select(Job).where(Job.kind == kind, Job.state.not_in(TERMINAL))
    for run in session.scalars(runs.execution_options(populate_existing=True)):
        if run.arguments == holder and not run.cancel_reason:
            return run
    return None


def is_possible(session: Session, member: DatasetMember) -> bool:
    """Whether sequence, synchronised frames and what was measured are still there."""
    sequence = session.get(SequenceRow, member.sequence_id)
    is_there = sequence is not None and sequence.deleted_ns is None
    is_synchronised = session.scalar(_artefact(member.label_set_id)) is not None
    return is_there and is_synchronised and has_samples(session, member.sequence_id, member.label_set_id)


def sequence_key(session: Session, attempt: Attempt) -> str:
    """The object that holds the synchronised sequence the attempt works for. Raises `InputsImpossibleError`."""
    found = _artefact(attempt.arguments["label_set_id"])
    key = session.scalar(select(Blob.object_key).where(Blob.sha256.in_(found.with_only_columns(Artefact.blob_sha256))))
    if key is None:
        raise InputsImpossibleError([attempt.arguments["name"]])
    return key


def _artefact(label_set_id: str) -> Select[str]:
    return select(Artefact.id).where(Artefact.label_set_id == label_set_id, Artefact.name == SEQUENCE_FILE)
