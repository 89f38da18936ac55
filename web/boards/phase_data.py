"""The downloads of a phase: inputs, the parts of its dataset version, baselines.

**Conventions.** For a hidden part they contain names, conditions and numbers of frames, which are public, and nothing
derived from labels. The routes decide who may download the bytes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.datasets import DatasetPartItem
from api.views.datasets import dataset_detail
from services.domain.benchmarks.phases.inputs import inputs_of
from services.domain.benchmarks.visibility import is_on_board, secrecy_of
from services.domain.datasets.input_jobs import inputs_of_members, members_of
from services.runtime.orm import (
    Blob,
    Dataset,
    DatasetInput,
    DatasetMember,
    Phase,
    PhaseInput,
    SubmissionRow,
)
from services.runtime.orm.base import now_ns

TRAIN = "train"


@dataclass(frozen=True)
class SequenceInput:
    """The inputs of a sequence; `url`, size and sha256 are empty while they are not made."""

    name: str
    environment: str
    illumination: str
    frames: int
    url: str = ""
    size_bytes: int = 0
    sha256: str = ""


@dataclass(frozen=True)
class BaselineZip:
    """The zip of a baseline on the board of an open phase."""

    submission_id: str
    method: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class PhaseDownloads:
    """`inputs` are those of the phase, `training` those of train; `parts` the labels of train and val."""

    dataset: str
    licence: str
    inputs: tuple[SequenceInput, ...]
    training: tuple[SequenceInput, ...]
    parts: tuple[DatasetPartItem, ...]
    baselines: tuple[BaselineZip, ...]


def phase_downloads(session: Session, phase: Phase) -> PhaseDownloads:
    dataset = session.get_one(Dataset, phase.dataset_id)
    made = {row.name: row for row in session.scalars(inputs_of(phase.id))}
    at = f"/api/v1/phases/{phase.id}/inputs"
    members = session.scalars(members_of(dataset.id, [phase.part])).all()
    return PhaseDownloads(
        dataset.name,
        dataset.licence,
        tuple(_input(member, made.get(member.name), at) for member in members),
        _training(session, dataset),
        tuple(dataset_detail(session, dataset).parts),
        _baselines(session, phase),
    )


def _training(session: Session, dataset: Dataset) -> tuple[SequenceInput, ...]:
    members: Sequence[DatasetMember] = session.scalars(members_of(dataset.id, [TRAIN])).all()
    at = f"/api/v1/datasets/{dataset.name}/inputs"
    return tuple(
        _input(member_input.member, member_input.made, at) for member_input in inputs_of_members(session, members)
    )


def _input(member: DatasetMember, made: PhaseInput | DatasetInput | None, at: str) -> SequenceInput:
    facts = (member.name, member.environment, member.illumination, member.frames)
    return (
        SequenceInput(*facts, f"{at}/{member.name}.tar", made.tar_bytes, made.tar_sha256)
        if made
        else SequenceInput(*facts)
    )


def _baselines(session: Session, phase: Phase) -> tuple[BaselineZip, ...]:
    """Return the baselines; none for a phase with hidden ground truth."""
    if secrecy_of(phase, now_ns()) != "open":
        return ()
    kept = select(SubmissionRow, Blob).join(Blob, Blob.sha256 == SubmissionRow.blob_sha256)
    baselines = kept.where(is_on_board(), SubmissionRow.phase_id == phase.id, SubmissionRow.kind == "baseline")
    rows = session.execute(baselines.order_by(SubmissionRow.method))
    return tuple(BaselineZip(row.id, row.method, blob.size_bytes, blob.sha256) for row, blob in rows)
