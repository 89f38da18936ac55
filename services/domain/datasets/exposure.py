"""Exposure: why anybody may have the labels of a sequence, in words; and which labels are hidden.

**Conventions.** What was public stays exposed, since whoever fetched its labels has them; so does what a version has in
train or val. A sequence that shares a file of its recordings with a public one is exposed too, also where that one is
deleted: the rows of its uploads stay.
"""

from collections.abc import Mapping
from datetime import UTC, datetime

from sqlalchemy import Select, and_, or_, select
from sqlalchemy.orm import Session

from services.runtime.orm import Dataset, DatasetMember, Phase, Recording, RecordingFile, SequenceRow, Upload
from stone.splits.splits import PARTS

HIDDEN = "test"
OPEN = tuple(part for part in PARTS if part != HIDDEN)


def exposures(session: Session) -> Mapping[str, str]:
    """Of every sequence whose labels anybody may have, the plainest reason, by its id."""
    return {**_sharing(session), **_in_versions(session), **_public(session)}


def hidden_truths() -> Select[str]:
    """The ids of the sequences that a version hides, or whose labels a hidden phase is scored against."""
    same_part = and_(Phase.dataset_id == DatasetMember.dataset_id, Phase.part == DatasetMember.part)
    members = select(DatasetMember.sequence_id).outerjoin(Phase, and_(same_part, Phase.is_hidden))
    return members.where(or_(DatasetMember.part == HIDDEN, Phase.id.is_not(None)))


def _public(session: Session) -> dict[str, str]:
    columns = (SequenceRow.id, SequenceRow.is_public, SequenceRow.published_ns)
    rows = session.execute(select(*columns).where(SequenceRow.published_ns.is_not(None)))
    return {one: "it is public" if is_public else f"it was public from {_day(at)} on" for one, is_public, at in rows}


def _in_versions(session: Session) -> dict[str, str]:
    named = select(DatasetMember.sequence_id, DatasetMember.part, Dataset.name).join(Dataset)
    rows = session.execute(named.where(DatasetMember.part.in_(OPEN)).order_by(Dataset.id.desc()))
    return {one: f"it is in {part} of version {name!r}" for one, part, name in rows}


def _sharing(session: Session) -> dict[str, str]:
    files = (
        select(Recording.sequence_id, SequenceRow.name)
        .join(RecordingFile)
        .join(Upload, (Upload.sha256 == RecordingFile.sha256) & (Upload.purpose == "recording"))
    )
    others = files.join(SequenceRow, SequenceRow.id == Upload.target_id).where(SequenceRow.id != Recording.sequence_id)
    rows = session.execute(others.where(SequenceRow.published_ns.is_not(None)).order_by(SequenceRow.id.desc()))
    return {one: f"it has a file of {name!r}, which is or was public" for one, name in rows}


def _day(at_ns: int | None) -> str:
    return datetime.fromtimestamp((at_ns or 0) / 1e9, UTC).date().isoformat()
