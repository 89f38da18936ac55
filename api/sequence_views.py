"""Sequences as the API shows them, with their newest run and labels; a page of them is four statements."""

from collections.abc import Iterable

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from api.preview_files import previews_of_sequence
from api.schemas.base import instant
from api.schemas.sequences import ArtefactItem, JobGlance, LabelGlance, SequenceDetail, SequenceItem
from api.visible import labels_of
from services.runtime.orm import Artefact, Job, LabelSet, Recording, Sequence

PACKS = "labels/"


def sequence_items(session: Session, sequences: Iterable[Sequence]) -> list[SequenceItem]:
    """Sequences as a list shows them."""
    rows = list(sequences)
    ids = [row.id for row in rows]
    recordings = _recordings(session, ids)
    jobs, labels = _newest_runs(session, ids), _newest_labels(session, ids)
    return [_item(row, recordings.get(row.id, 0), jobs.get(row.id), labels.get(row.id)) for row in rows]


def sequence_detail(session: Session, sequence: Sequence) -> SequenceDetail:
    """A sequence with the files of its newest labels."""
    item = sequence_items(session, [sequence])[0]
    artefacts = _artefacts(session, item.labels.id) if item.labels else []
    previews = previews_of_sequence(session, sequence, labels_of(session, sequence.id))
    return SequenceDetail(**dict(item), artefacts=artefacts, previews=previews)


def _item(row: Sequence, recordings: int, job: JobGlance | None, labels: LabelSet | None) -> SequenceItem:
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
        recordings=recordings,
        job=job,
        labels=_labels(labels) if labels else None,
        revision=row.revision,
        created_at=instant(row.created_ns),
    )


def _labels(row: LabelSet) -> LabelGlance:
    return LabelGlance(id=row.id, job_id=row.job_id, frames=row.frames, created_at=instant(row.created_ns))


def _recordings(session: Session, ids: list[str]) -> dict[str, int]:
    counted = select(Recording.sequence_id, func.count()).where(Recording.sequence_id.in_(ids))
    return dict(session.execute(counted.group_by(Recording.sequence_id)).all())


def _newest_runs(session: Session, ids: list[str]) -> dict[str, JobGlance]:
    newest = select(func.max(Job.id)).where(Job.sequence_id.in_(ids), Job.id == Job.root_id).group_by(Job.sequence_id)
    found = select(Job.sequence_id, Job.id, Job.kind, Job.state).where(Job.id.in_(newest))
    return {of: JobGlance(id=id, kind=kind, state=state) for of, id, kind, state in session.execute(found) if of}


def _newest_labels(session: Session, ids: list[str]) -> dict[str, LabelSet]:
    newest = select(func.max(LabelSet.id)).where(LabelSet.sequence_id.in_(ids)).group_by(LabelSet.sequence_id)
    return {row.sequence_id: row for row in session.scalars(select(LabelSet).where(LabelSet.id.in_(newest)))}


def _artefacts(session: Session, label_set_id: str) -> list[ArtefactItem]:
    files = select(Artefact).where(Artefact.label_set_id == label_set_id).order_by(Artefact.name)
    return [
        ArtefactItem(name=row.name, media_type=row.media_type, size_bytes=row.size_bytes, sha256=row.blob_sha256)
        for row in session.scalars(files)
        if not row.name.startswith(PACKS)
    ]
