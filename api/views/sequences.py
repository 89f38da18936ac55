"""Sequences as the API shows them, with their newest run and the labels that count; a page of them is six statements.

**Conventions.** Without a caller they are shown as a visitor sees them.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import BindParameter, bindparam, func, select
from sqlalchemy.orm import Session

from api.deps import VISITOR, Caller
from api.schemas.base import instant
from api.schemas.sequences.sequences import (
    ArtefactItem,
    ClassVoxels,
    JobGlance,
    LabelGlance,
    LaterRecordingsItem,
    SequenceDetail,
    SequenceItem,
)
from api.views.preview_files import previews_of_sequence
from api.visible import labels_of
from services.domain.sequences.later_recordings import later_recordings
from services.domain.sequences.processing import PROCESS, REGISTER
from services.runtime.orm import Artefact, Job, LabelSet, Recording, SequenceRow, SplitMember

UNLISTED = ("labels/", "scene/")
PICTURES = ("bev.png", "thumbnail.jpg", "thumbnail.png")  # of older label sets a JPEG

# Built once: to build a statement for fifty ids costs more than to run it.
IDS: BindParameter[Any] = bindparam("ids", expanding=True)
RECORDINGS = (
    select(Recording.sequence_id, func.count()).where(Recording.sequence_id.in_(IDS)).group_by(Recording.sequence_id)
)
_IS_RUN = (Job.sequence_id.in_(IDS), Job.id == Job.root_id, Job.kind.in_((PROCESS, REGISTER)))
NEWEST_RUNS = select(Job.sequence_id, Job.id, Job.kind, Job.state).where(
    Job.id.in_(select(func.max(Job.id)).where(*_IS_RUN).group_by(Job.sequence_id))
)
_PLACE = func.row_number().over(
    partition_by=LabelSet.sequence_id, order_by=(LabelSet.chosen_ns.desc(), LabelSet.id.desc())
)
_PLACED = select(LabelSet.id, _PLACE.label("place")).where(LabelSet.sequence_id.in_(IDS)).subquery()
COUNTING_LABELS = select(LabelSet).where(LabelSet.id.in_(select(_PLACED.c.id).where(_PLACED.c.place == 1)))
SPLITS = select(SplitMember.sequence_id, SplitMember.part).where(SplitMember.sequence_id.in_(IDS))
NAMED_PICTURES = (
    select(Artefact.label_set_id, Artefact.name)
    .where(Artefact.label_set_id.in_(IDS), Artefact.name.in_(PICTURES))
    .order_by(Artefact.name)
)


@dataclass(frozen=True)
class _SequenceExtras:
    """Facts about sequences from other tables, by sequence id."""

    recordings: dict[str, int]
    jobs: dict[str, JobGlance]
    labels: dict[str, LabelSet]
    splits: dict[str, str]
    pictures: dict[str, str]


def sequence_items(session: Session, sequences: Iterable[SequenceRow], caller: Caller = VISITOR) -> list[SequenceItem]:
    """Sequences as a list shows them."""
    rows = list(sequences)
    ids = [row.id for row in rows]
    own = ids if caller.is_administrator else [row.id for row in rows if row.owner_id == caller.user_id]
    labels = _counting_labels(session, ids)
    pictures = _pictures(session, [row.id for row in labels.values()])
    known = _SequenceExtras(
        _recordings(session, ids), _newest_runs(session, ids), labels, _splits(session, own), pictures
    )
    return [_item(row, known) for row in rows]


def sequence_detail(session: Session, sequence: SequenceRow, caller: Caller = VISITOR) -> SequenceDetail:
    """A sequence with the files of the labels that count."""
    item = sequence_items(session, [sequence], caller)[0]
    artefacts = _artefacts(session, item.labels.id) if item.labels else []
    labels = labels_of(session, sequence.id)
    previews = previews_of_sequence(session, sequence, labels)
    is_own = caller.is_administrator or sequence.owner_id == caller.user_id
    later = later_recordings(session, sequence, labels) if is_own and labels else None
    shown = LaterRecordingsItem(names=list(later.names), why_not=later.why_not) if later else None
    return SequenceDetail(**dict(item), artefacts=artefacts, previews=previews, later_recordings=shown)


def _item(row: SequenceRow, known: _SequenceExtras) -> SequenceItem:
    labels = known.labels.get(row.id)
    return SequenceItem(
        id=row.id,
        owner_id=row.owner_id,
        name=row.name,
        environment=row.environment,
        illumination=row.illumination,
        region=row.region,
        platform=row.platform,
        is_public=row.is_public,
        calibration_id=row.calibration_id,
        recordings=known.recordings.get(row.id, 0),
        job=known.jobs.get(row.id),
        labels=_labels(labels) if labels else None,
        class_voxels=_class_voxels(labels) if labels else None,
        duration_s=labels.duration_ns / 1e9 if labels and labels.duration_ns is not None else None,
        distance_m=labels.distance_m if labels else None,
        split=known.splits.get(row.id),
        picture=known.pictures.get(labels.id) if labels else None,
        revision=row.revision,
        created_at=instant(row.created_ns),
    )


def _class_voxels(row: LabelSet) -> ClassVoxels | None:
    if row.t_voxels is None or row.p_voxels is None or row.n_voxels is None:
        return None
    return ClassVoxels(t=row.t_voxels, p=row.p_voxels, n=row.n_voxels)


def _labels(row: LabelSet) -> LabelGlance:
    return LabelGlance(
        id=row.id,
        job_id=row.job_id,
        frames=row.frames,
        code_version=row.code_version,
        created_at=instant(row.created_ns),
        chosen_at=instant(row.chosen_ns),
    )


def _recordings(session: Session, ids: list[str]) -> dict[str, int]:
    return dict(session.execute(RECORDINGS, {"ids": ids}).all())


def _newest_runs(session: Session, ids: list[str]) -> dict[str, JobGlance]:
    """The newest labellings or readings of sequences; an export or a comparison has a state of its own."""
    found = session.execute(NEWEST_RUNS, {"ids": ids})
    return {of: JobGlance(id=id, kind=kind, state=state) for of, id, kind, state in found if of}


def _counting_labels(session: Session, ids: list[str]) -> dict[str, LabelSet]:
    """Of several label sets the one requested last, as `counting_labels` has it for one sequence."""
    return {row.sequence_id: row for row in session.scalars(COUNTING_LABELS, {"ids": ids})}


def _splits(session: Session, ids: list[str]) -> dict[str, str]:
    """The part of the splits under discussion that each is in."""
    return dict(session.execute(SPLITS, {"ids": ids}).all()) if ids else {}


def _pictures(session: Session, label_set_ids: list[str]) -> dict[str, str]:
    """The name of the smallest picture that shows each label set from above."""
    if not label_set_ids:
        return {}
    return dict(session.execute(NAMED_PICTURES, {"ids": label_set_ids}).all())  # the thumbnail comes last and counts


def _artefacts(session: Session, label_set_id: str) -> list[ArtefactItem]:
    files = select(Artefact).where(Artefact.label_set_id == label_set_id).order_by(Artefact.name)
    return [
        ArtefactItem(name=row.name, media_type=row.media_type, size_bytes=row.size_bytes, sha256=row.blob_sha256)
        for row in session.scalars(files)
        if not row.name.startswith(UNLISTED)
    ]
