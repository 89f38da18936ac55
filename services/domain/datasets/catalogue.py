"""The catalogue: sequences with labels, from which a dataset can be made.

**Conventions.** If a sequence has several label sets, the most recently requested set is active. All data come from
rows, in a fixed number of statements. Drives are computed over the sequences of all owners, and named after the first
visible sequence.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Select, and_, func, or_, select
from sqlalchemy.orm import Session, aliased

from services.runtime.orm import Dataset, DatasetMember, LabelSet, Phase, Recording, RecordingFile, SequenceRow, Upload
from stone.splits.composition import CatalogueEntry, Voxels
from stone.splits.drives import DrivenTrack, drives_of
from stone.splits.splits import PARTS

REGISTERED = "registered"
Drives = Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class CatalogueSequence:
    """A sequence with its active labels."""

    sequence: SequenceRow
    labels: LabelSet
    entry: CatalogueEntry


def labelled_sequences(session: Session, among: Select[SequenceRow] | None = None) -> tuple[CatalogueSequence, ...]:
    """Return the labelled sequences by name and id: all that are not deleted, or those selected by `among`."""
    newest = (
        select(LabelSet, func.row_number().over(partition_by=LabelSet.sequence_id, order_by=_LAST_FIRST).label("place"))
    ).subquery()
    counting = aliased(LabelSet, newest)
    sequences = (select(SequenceRow) if among is None else among).where(SequenceRow.deleted_ns.is_(None)).subquery()
    sequence = aliased(SequenceRow, sequences)
    labelled = select(sequence, counting).join(counting, counting.sequence_id == sequence.id).where(newest.c.place == 1)
    rows = session.execute(labelled.order_by(sequence.name, sequence.id)).all()
    recordings, tracks = _recordings(session, [row.id for row, _ in rows]), _tracks(session)
    drives = drives_of({sequence_id: track for sequence_id, (_, track) in tracks.items()})
    exposed = _with_drives(exposures(session), drives, {sequence_id: name for sequence_id, (name, _) in tracks.items()})
    entries = [
        replace(
            _entry(row, labels, recordings.get(row.id, ())),
            exposure=exposed.get(row.id, ""),
            track=tracks[row.id][1] if row.id in tracks else None,
        )
        for row, labels in rows
    ]
    named = _in_drives(entries, drives)
    return tuple(CatalogueSequence(row, labels, named[row.id]) for row, labels in rows)


def entries_of(labelled: Iterable[CatalogueSequence]) -> tuple[CatalogueEntry, ...]:
    return tuple(sequence.entry for sequence in labelled)


def voxels_of(t_voxels: int | None, p_voxels: int | None, n_voxels: int | None) -> Voxels | None:
    """Return (T, P, N), or None if an earlier version did not count them."""
    if t_voxels is None or p_voxels is None or n_voxels is None:
        return None
    return t_voxels, p_voxels, n_voxels


def _tracks(session: Session) -> dict[str, tuple[str, DrivenTrack]]:
    """Return the name and track, by id, of each sequence whose labels have a track."""
    rank = func.row_number().over(partition_by=LabelSet.sequence_id, order_by=_LAST_FIRST)
    newest = select(LabelSet.sequence_id, LabelSet.track, rank.label("place")).subquery()
    rows = select(SequenceRow.id, SequenceRow.name, newest.c.track).join(newest, newest.c.sequence_id == SequenceRow.id)
    records = session.execute(rows.where(newest.c.place == 1).order_by(SequenceRow.id))
    return {sequence_id: (name, track_from(record)) for sequence_id, name, record in records if record}


def track_from(record: Mapping[str, Any]) -> DrivenTrack:
    """Return the track in a label set's row."""
    return DrivenTrack(**{**record, "places": tuple(map(tuple, record["places"]))})


def _in_drives(entries: Iterable[CatalogueEntry], drives: Drives) -> dict[str, CatalogueEntry]:
    """Return the entries with their drives, by id; a drive with only one visible sequence has no name."""
    by_id = {entry.id: entry for entry in entries}
    of_drive = {
        sequence_id: [by_id[other] for other in drives.get(sequence_id, (sequence_id,)) if other in by_id]
        for sequence_id in by_id
    }
    firsts = {members[0].id: members[0].name for members in of_drive.values() if len(members) > 1}
    times = Counter(firsts.values())
    names = {
        sequence_id: name if times[name] == 1 else f"{name[:80]} ({sequence_id[:12]})"
        for sequence_id, name in firsts.items()
    }
    return {
        sequence_id: replace(
            by_id[sequence_id], drive=names[members[0].id], drive_s=sum(other.duration_s for other in members)
        )
        if len(members) > 1
        else by_id[sequence_id]
        for sequence_id, members in of_drive.items()
    }


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
    """Return the sha256 of each registered recording, by sequence."""
    hashes = dict[str, tuple[str, ...]]()
    kept = select(Recording.sequence_id, Recording.sha256).where(Recording.state == REGISTERED)
    for start in range(0, len(ids), AT_A_TIME):
        some = kept.where(Recording.sequence_id.in_(ids[start : start + AT_A_TIME])).order_by(Recording.id)
        for sequence_id, sha256 in session.execute(some):
            hashes[sequence_id] = (*hashes.get(sequence_id, ()), sha256)
    return hashes


AT_A_TIME = 1000


# Exposure: the reason for which the labels of a sequence may be publicly known, and hidden labels. Exposure is
# permanent: labels may have been downloaded while the sequence was public or while a version had it in train or val. A
# sequence that shares a recording file with a public sequence is exposed too, even if the public one is deleted: the
# rows of its uploads stay.


HIDDEN = "test"
OPEN = tuple(part for part in PARTS if part != HIDDEN)


def exposures(session: Session) -> Mapping[str, str]:
    """Return the plainest reason of exposure, by id, of every sequence whose labels may be publicly known."""
    return {**_sharing(session), **_in_versions(session), **_public(session)}


def _with_drives(exposed: Mapping[str, str], drives: Drives, names: Mapping[str, str]) -> Mapping[str, str]:
    """Add the sequences of exposed drives: labels of the same ground reveal theirs."""
    reasons = dict(exposed)
    for drive in set(drives.values()):
        known = next((sequence_id for sequence_id in drive if sequence_id in exposed), None)
        if known is not None and len(drive) > 1:
            why = f"{names[known]!r} of the same drive {exposed[known].removeprefix('it ')}"
            reasons |= {sequence_id: why for sequence_id in drive if sequence_id not in exposed}
    return reasons


def hidden_truths() -> Select[str]:
    """Select the ids of sequences that a version hides, or whose labels are a hidden phase's ground truth."""
    same_part = and_(Phase.dataset_id == DatasetMember.dataset_id, Phase.part == DatasetMember.part)
    members = select(DatasetMember.sequence_id).outerjoin(Phase, and_(same_part, Phase.is_hidden))
    return members.where(or_(DatasetMember.part == HIDDEN, Phase.id.is_not(None)))


def _public(session: Session) -> dict[str, str]:
    columns = (SequenceRow.id, SequenceRow.is_public, SequenceRow.published_ns)
    rows = session.execute(select(*columns).where(SequenceRow.published_ns.is_not(None)))
    return {
        sequence_id: "it is public" if is_public else f"it was public from {_day(at)} on"
        for sequence_id, is_public, at in rows
    }


def _in_versions(session: Session) -> dict[str, str]:
    named = select(DatasetMember.sequence_id, DatasetMember.part, Dataset.name).join(Dataset)
    rows = session.execute(named.where(DatasetMember.part.in_(OPEN)).order_by(Dataset.id.desc()))
    return {sequence_id: f"it is in {part} of version {name!r}" for sequence_id, part, name in rows}


def _sharing(session: Session) -> dict[str, str]:
    files = (
        select(Recording.sequence_id, SequenceRow.name)
        .join(RecordingFile)
        .join(Upload, (Upload.sha256 == RecordingFile.sha256) & (Upload.purpose == "recording"))
    )
    others = files.join(SequenceRow, SequenceRow.id == Upload.target_id).where(SequenceRow.id != Recording.sequence_id)
    rows = session.execute(others.where(SequenceRow.published_ns.is_not(None)).order_by(SequenceRow.id.desc()))
    return {sequence_id: f"it shares a file with {name!r}, which is or was public" for sequence_id, name in rows}


def _day(at_ns: int | None) -> str:
    return datetime.fromtimestamp((at_ns or 0) / 1e9, UTC).date().isoformat()
