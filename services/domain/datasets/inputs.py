"""Inputs of a version: the sensor data of its train and val sequences, to train on beside its labels.

**Conventions.** Each is made once (`services/domain/datasets/input_jobs.py` says of what), when the version is
published or when an administrator asks, and stays as the version does: its bytes are held by foreign keys to blobs.
It is no part of the manifest, which stands before it. Those of test are neither made nor located here, whoever asks.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.datasets.exposure import OPEN
from services.domain.datasets.input_jobs import (
    InputResult,
    InputsImpossibleError,
    InputsStandError,
    add_input,
    input_spec,
    is_possible,
    members_of,
    run_under_way,
)
from services.domain.exports.requests import LAST
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobCancelledError, QueueDrainingError
from services.runtime.jobs.specs import Attempt, Context
from services.runtime.orm import Blob, Dataset, DatasetInput, DatasetInputPack, DatasetMember, Job
from services.runtime.store.pack_reading import ExportLocation

RUN = "dataset.inputs"
InputState = Literal["ready", "missing", "lost"]


@dataclass(frozen=True, eq=False)
class MemberInput:
    """An open sequence of a version with its input, None while there is none.

    `missing`: it is being made, or an administrator may have it made; `lost`: what it would be made of is gone.
    """

    member: DatasetMember
    made: DatasetInput | None
    state: InputState


def start_version_inputs(session: Session, dataset: Dataset, user_id: str) -> Job:
    """The run that makes what is missing and can be made: the one that is at it, or a new one.

    Raises `InputsStandError`, `InputsImpossibleError` where all that is missing is lost, `QueueDrainingError`.
    """
    session.scalars(select(Dataset.id).where(Dataset.id == dataset.id).with_for_update(key_share=True)).one()
    holder = {"dataset_id": dataset.id}
    if run := run_under_way(session, RUN, holder):
        return run
    members = session.scalars(members_of(dataset.id, OPEN)).all()
    found = inputs_of_members(session, members)
    if missing := [one.member for one in found if one.state == "missing"]:
        return _enqueued(session, dataset, missing, Context(user_id))
    if lost := [one.member.name for one in found if one.state == "lost"]:
        raise InputsImpossibleError(lost)
    raise InputsStandError(f"version {dataset.name!r}", len(members))


def follow_publication(session: Session, dataset: Dataset, user_id: str) -> None:
    """Have the inputs of a version made that is being published, after all that somebody asked for.

    Sequences that lost their recording are left out; nothing happens where the queue is draining.
    """
    possible = [one for one in session.scalars(members_of(dataset.id, OPEN)) if is_possible(session, one)]
    if possible:
        with suppress(QueueDrainingError):
            _enqueued(session, dataset, possible, Context(user_id, None, LAST))


def inputs_of_members(session: Session, members: Sequence[DatasetMember]) -> tuple[MemberInput, ...]:
    """What there is of each of these open sequences of one version."""
    return tuple(_input_of(session, member) for member in members)


def located_input(session: Session, dataset: Dataset, name: str) -> tuple[DatasetInput, ExportLocation] | None:
    """An input and where its files lie; None where there is none, and for whatever is not in train or val."""
    named = members_of(dataset.id, OPEN).where(DatasetMember.name == name)
    row = session.get(DatasetInput, (dataset.id, name)) if session.scalars(named.limit(1)).one_or_none() else None
    if row is None:
        return None
    packs = select(Blob.object_key).join(DatasetInputPack, DatasetInputPack.blob_sha256 == Blob.sha256)
    own = packs.where(DatasetInputPack.dataset_id == dataset.id, DatasetInputPack.name == name)
    index = session.get_one(Blob, row.index_sha256)
    return row, ExportLocation(index.object_key, tuple(session.scalars(own.order_by(DatasetInputPack.ordinal))))


def write_version_input(session: Session, attempt: Attempt, made: InputResult) -> None:
    """Write down what a job has made, in the transaction of its success; what stands already stays.

    Raises `JobCancelledError` when the version was deleted.
    """
    dataset = version_of_attempt(session, attempt)
    if session.get(DatasetInput, (dataset.id, made.name)) is not None:
        return
    row = DatasetInput(dataset_id=dataset.id, name=made.name)
    packs = [
        DatasetInputPack(dataset_id=dataset.id, name=made.name, ordinal=ordinal, blob_sha256=pack.sha256)
        for ordinal, pack in enumerate(made.packs)
    ]
    add_input(session, made, row, packs)


def version_of_attempt(session: Session, attempt: Attempt) -> Dataset:
    """The version the attempt works for, its row locked. Raises `JobCancelledError` when it was deleted."""
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


def _enqueued(session: Session, dataset: Dataset, members: Sequence[DatasetMember], context: Context) -> Job:
    holder = {"dataset_id": dataset.id}
    run = enqueue_run(session, RUN, [input_spec(holder, member) for member in members], context)
    run.arguments = holder
    return run
