"""The catalogue: sequences with labels, which a dataset can be made of.

**Conventions.** Of several label sets of a sequence the one that was asked for last counts. All comes from rows, in a
fixed number of statements.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.orm import Session, aliased

from services.runtime.orm import Dataset, DatasetMember, LabelSet, Phase, Recording, RecordingFile, SequenceRow, Upload
from stone.splits.composition import CatalogueEntry, Voxels
from stone.splits.splits import PARTS

REGISTERED = "registered"


@dataclass(frozen=True)
class CatalogueSequence:
    """A sequence with the labels that count."""

    sequence: SequenceRow
    labels: LabelSet
    entry: CatalogueEntry


def labelled_sequences(session: Session, among: Select[SequenceRow] | None = None) -> tuple[CatalogueSequence, ...]:
    """Sequences that have labels, by name and id: all that are not deleted, or those `among` that are selected."""
    newest = (
        select(LabelSet, func.row_number().over(partition_by=LabelSet.sequence_id, order_by=_LAST_FIRST).label("place"))
    ).subquery()
    counting = aliased(LabelSet, newest)
    sequences = (select(SequenceRow) if among is None else among).where(SequenceRow.deleted_ns.is_(None)).subquery()
    sequence = aliased(SequenceRow, sequences)
    found = select(sequence, counting).join(counting, counting.sequence_id == sequence.id).where(newest.c.place == 1)
    rows = session.execute(found.order_by(sequence.name, sequence.id)).all()
    recordings, exposed = _recordings(session, [row.id for row, _ in rows]), exposures(session)
    return tuple(
        CatalogueSequence(
            row, labels, replace(_entry(row, labels, recordings.get(row.id, ())), exposure=exposed.get(row.id, ""))
        )
        for row, labels in rows
    )


def entries_of(labelled: Iterable[CatalogueSequence]) -> tuple[CatalogueEntry, ...]:
    return tuple(one.entry for one in labelled)


def voxels_of(t_voxels: int | None, p_voxels: int | None, n_voxels: int | None) -> Voxels | None:
    """(T, P, N); None where an earlier version did not count them."""
    if t_voxels is None or p_voxels is None or n_voxels is None:
        return None
    return t_voxels, p_voxels, n_voxels


_LAST_FIRST = (LabelSet.chosen_ns.desc(), LabelSet.id.desc())


def _entry(row: SequenceRow, labels: LabelSet, recordings: tuple[str, ...]) -> CatalogueEntry:
    return CatalogueEntry(
        id=row.id,
        name=row.name,
        environment=row.environment,
        illumination=row.illumination,
        region=row.region,
        duration_s=(labels.duration_ns or 0) / 1e9,
        frames=labels.frames,
        voxels=voxels_of(labels.t_voxels, labels.p_voxels, labels.n_voxels),
        distance_m=labels.distance_m,
        recordings=recordings,
        quality=labels.quality,
    )


def _recordings(session: Session, ids: list[str]) -> Mapping[str, tuple[str, ...]]:
    """The sha256 of each registered recording, by sequence."""
    found = dict[str, tuple[str, ...]]()
    kept = select(Recording.sequence_id, Recording.sha256).where(Recording.state == REGISTERED)
    for start in range(0, len(ids), AT_A_TIME):
        some = kept.where(Recording.sequence_id.in_(ids[start : start + AT_A_TIME])).order_by(Recording.id)
        for sequence_id, sha256 in session.execute(some):
            found[sequence_id] = (*found.get(sequence_id, ()), sha256)
    return found


AT_A_TIME = 1000


# Exposure: why anybody may have the labels of a sequence, in words; and which labels are hidden.
#
# **Conventions.** What was public stays exposed, since whoever fetched its labels has them; so does what a version has
# in train or val. A sequence that shares a file of its recordings with a public one is exposed too, also where that
# one is deleted: the rows of its uploads stay.


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
