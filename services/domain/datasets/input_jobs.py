"""Inputs: the sensor data of a version's sequence, made by a job for a phase or for the version itself.

**Conventions.** An input is made from the synchronised sequence that the version was published with, and from the
measurements (`services/domain/sequences/label_sources.py`). The job cannot locate labels, mesh or report. The job's
arguments name the holder, a phase or version. An input is never made again, so a sequence without its recording will
have none.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Sequence as Listing
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.domain.datasets.catalogue import OPEN
from services.domain.exports.requests import LAST
from services.domain.sequences.label_sources import has_samples
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobCancelledError, QueueDrainingError
from services.runtime.jobs.specs import TERMINAL, Attempt, Context, JobSpec
from services.runtime.orm import (
    Artefact,
    Blob,
    Dataset,
    DatasetInput,
    DatasetInputPack,
    DatasetMember,
    Job,
    PhaseInput,
    PhaseInputPack,
    SequenceRow,
)
from services.runtime.store.blobs import PreparedBlob, link_all
from services.runtime.store.pack_reading import ExportLocation
from services.runtime.store.packs import PackedFiles
from stone.errors import Refused
from stone_files.joined_file import JOINED

INPUTS = "labeler.inputs"


def inputs_complete(holder: str, count: int) -> Refused:
    return Refused(
        "inputs_complete", f"the inputs of all {count} sequences of {holder} exist already; inputs never change"
    )


def inputs_impossible(names: Listing[str]) -> Refused:
    shown = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
    return Refused(
        "inputs_impossible",
        f"{len(names)} sequences were deleted or have lost their recording: {shown}; upload them again, or publish a "
        "dataset version without them",
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
    kinds: tuple[type[DatasetInput], type[DatasetInputPack]] | tuple[type[PhaseInput], type[PhaseInputPack]],
    holder: Mapping[str, str],
) -> None:
    """Write rows of these kinds for a job's result and link its blobs; an existing input of the holder stays."""
    row_kind, pack_kind = kinds
    if session.get(row_kind, (*holder.values(), made.name)) is not None:
        return
    link_all(session, (made.index, *made.packs))
    row = row_kind(**holder, name=made.name, index_sha256=made.index.sha256, files=len(made.files))
    row.size_bytes = int(made.files.sizes_bytes.sum())
    row.tar_bytes, row.tar_sha256 = made.tar
    session.add(row)
    session.flush()
    for ordinal, pack in enumerate(made.packs):
        session.add(pack_kind(**holder, name=made.name, ordinal=ordinal, blob_sha256=pack.sha256))


def members_of(dataset_id: str, parts: Listing[str]) -> Select[DatasetMember]:
    """Select the sequences of these parts of a version, by name."""
    in_version = select(DatasetMember).where(DatasetMember.dataset_id == dataset_id)
    return in_version.where(DatasetMember.part.in_(parts)).order_by(DatasetMember.name)


def input_spec(holder: Mapping[str, str], member: DatasetMember) -> JobSpec:
    """Return the job that makes the member's input for its holder."""
    of = {"name": member.name, "sequence_id": member.sequence_id, "label_set_id": member.label_set_id}
    return JobSpec(INPUTS, {**holder, **of})


def run_under_way(session: Session, kind: str, holder: Mapping[str, str]) -> Job | None:
    """Return the run that makes inputs for this holder, unless it is being cancelled."""
    runs = select(Job).where(Job.kind == kind, Job.state.not_in(TERMINAL))
    for run in session.scalars(runs.execution_options(populate_existing=True)):
        if run.arguments == holder and not run.cancel_reason:
            return run
    return None


def is_possible(session: Session, member: DatasetMember) -> bool:
    """Return whether sequence, synchronised frames and measurements still exist."""
    sequence = session.get(SequenceRow, member.sequence_id)
    is_there = sequence is not None and sequence.deleted_ns is None
    is_synchronised = session.scalar(_artefact(member.label_set_id)) is not None
    return is_there and is_synchronised and has_samples(session, member.sequence_id, member.label_set_id)


def sequence_key(session: Session, attempt: Attempt) -> str:
    """Return the key of the attempt's synchronised sequence. Raises `inputs_impossible`."""
    artefacts = _artefact(attempt.arguments["label_set_id"])
    key = session.scalar(
        select(Blob.object_key).where(Blob.sha256.in_(artefacts.with_only_columns(Artefact.blob_sha256)))
    )
    if key is None:
        raise inputs_impossible([attempt.arguments["name"]])
    return key


def joined_key(session: Session, attempt: Attempt) -> str | None:
    """Return the key of the object that describes the joined recordings; None for a single recording."""
    blobs = _artefact(attempt.arguments["label_set_id"], JOINED).with_only_columns(Artefact.blob_sha256)
    return session.scalar(select(Blob.object_key).where(Blob.sha256.in_(blobs)))


def _artefact(label_set_id: str, name: str = SEQUENCE_FILE) -> Select[str]:
    return select(Artefact.id).where(Artefact.label_set_id == label_set_id, Artefact.name == name)


# Inputs of a version: the sensor data of its train and val sequences, for training with its labels. Each input is made
# once, at publication or when an administrator requests it, and is kept as long as the version by foreign keys to
# blobs. Inputs are not in the manifest, which exists before them. Inputs of test are neither made nor located here.


RUN = "dataset.inputs"
InputState = Literal["ready", "missing", "lost"]


@dataclass(frozen=True, eq=False)
class MemberInput:
    """An open sequence of a version with its input, or None.

    `missing`: being made, or an administrator may request it; `lost`: its source was deleted.
    """

    member: DatasetMember
    made: DatasetInput | None
    state: InputState


def start_version_inputs(session: Session, dataset: Dataset, user_id: str) -> Job:
    """Return the run that makes the missing inputs: the current run, or a new one.

    Raises `inputs_complete`, `inputs_impossible` if all missing inputs are lost, `QueueDrainingError`.
    """
    session.scalars(select(Dataset.id).where(Dataset.id == dataset.id).with_for_update(key_share=True)).one()
    holder = {"dataset_id": dataset.id}
    if run := run_under_way(session, RUN, holder):
        return run
    members = session.scalars(members_of(dataset.id, OPEN)).all()
    inputs = inputs_of_members(session, members)
    if missing := [entry.member for entry in inputs if entry.state == "missing"]:
        return _enqueue_inputs(session, dataset, missing, Context(user_id))
    if lost := [entry.member.name for entry in inputs if entry.state == "lost"]:
        raise inputs_impossible(lost)
    raise inputs_complete(f"version {dataset.name!r}", len(members))


def follow_publication(session: Session, dataset: Dataset, user_id: str) -> None:
    """Queue the inputs of a version at publication, with lower priority than user requests.

    Sequences without a recording are left out; nothing is queued while the queue is draining.
    """
    possible = [member for member in session.scalars(members_of(dataset.id, OPEN)) if is_possible(session, member)]
    if possible:
        with suppress(QueueDrainingError):
            _enqueue_inputs(session, dataset, possible, Context(user_id, None, LAST))


def inputs_of_members(session: Session, members: Sequence[DatasetMember]) -> tuple[MemberInput, ...]:
    """Return the state of the input of each of these open sequences of one version."""
    return tuple(_input_of(session, member) for member in members)


def located_input(session: Session, dataset: Dataset, name: str) -> tuple[DatasetInput, ExportLocation] | None:
    """Return an input and the location of its files; None if it does not exist or is not in train or val."""
    named = members_of(dataset.id, OPEN).where(DatasetMember.name == name)
    row = session.get(DatasetInput, (dataset.id, name)) if session.scalars(named.limit(1)).one_or_none() else None
    if row is None:
        return None
    packs = select(Blob.object_key).join(DatasetInputPack, DatasetInputPack.blob_sha256 == Blob.sha256)
    own = packs.where(DatasetInputPack.dataset_id == dataset.id, DatasetInputPack.name == name)
    index = session.get_one(Blob, row.index_sha256)
    return row, ExportLocation(index.object_key, tuple(session.scalars(own.order_by(DatasetInputPack.ordinal))))


def write_version_input(session: Session, attempt: Attempt, made: InputResult) -> None:
    """Write a job's result in the transaction of its success; an existing input stays.

    Raises `JobCancelledError` if the version was deleted.
    """
    dataset = version_of_attempt(session, attempt)
    add_input(session, made, (DatasetInput, DatasetInputPack), {"dataset_id": dataset.id})


def version_of_attempt(session: Session, attempt: Attempt) -> Dataset:
    """Return the attempt's version with its row locked. Raises `JobCancelledError` if the version was deleted."""
    wanted = select(Dataset).where(Dataset.id == attempt.arguments["dataset_id"]).with_for_update(key_share=True)
    dataset = session.scalars(wanted).one_or_none()
    if dataset is None:
        raise JobCancelledError("its dataset version was deleted")
    return dataset


def _input_of(session: Session, member: DatasetMember) -> MemberInput:
    made = session.get(DatasetInput, (member.dataset_id, member.name))
    if made is not None:
        return MemberInput(member, made, "ready")
    return MemberInput(member, None, "missing" if is_possible(session, member) else "lost")


def _enqueue_inputs(session: Session, dataset: Dataset, members: Sequence[DatasetMember], context: Context) -> Job:
    holder = {"dataset_id": dataset.id}
    run = enqueue_run(session, RUN, [input_spec(holder, member) for member in members], context)
    run.arguments = holder
    return run
