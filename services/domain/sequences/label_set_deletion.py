"""Deletion of label sets: refused while other objects rely on the set; the sweeper deletes unused sets, oldest first.

**Conventions.** Each function is part of the caller's transaction. Deleting a set deletes its comparisons, its
automatic playback and the previews of its recipe; the storage quota of the sequence's owner gets their bytes back.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from sqlalchemy import delete, func, or_, select
from sqlalchemy.orm import Session

from services.domain.exports.requests import counting_labels, delete_export
from services.domain.sequences.processing import lock_sequence
from services.domain.sequences.processing_errors import SequenceDeletedError
from services.domain.viewer.playback import PLAYBACK
from services.runtime.access import storage_quota
from services.runtime.access.audit_chain import append_own
from services.runtime.jobs.control import cancel
from services.runtime.jobs.errors import JobStateError
from services.runtime.orm import (
    Dataset,
    DatasetMember,
    Export,
    GroundTruthRow,
    LabelComparison,
    LabelSet,
    Phase,
    Preview,
    SequenceRow,
    SplitMember,
)
from services.runtime.platform import Platform
from stone.errors import Refused

SEQUENCES_AT_A_TIME = 50


def delete_label_set(session: Session, labels: LabelSet) -> None:
    """Delete a label set and everything made from it alone. Raises `label_set_pinned`, `SequenceDeletedError`."""
    sequence = lock_sequence(session, labels.sequence_id)
    if pins := list(label_set_pins(session, sequence, labels)):
        raise Refused(
            "label_set_pinned",
            f"label set {labels.id} cannot be deleted: {'; '.join(pins)[:400]}; delete or change these first",
        )
    of_labels = Export.label_set_id == labels.id
    for export in session.scalars(select(Export).where(of_labels)).all():
        delete_export(session, export)
    compared = or_(LabelComparison.a_id == labels.id, LabelComparison.b_id == labels.id)
    gone = delete(LabelComparison).where(compared).returning(LabelComparison.id, LabelComparison.job_id)
    subjects = [labels.id]
    for comparison_id, job_id in session.execute(gone).all():
        subjects.append(comparison_id)
        with suppress(JobStateError):  # the job has ended
            cancel(session, job_id, "a label set of its comparison was deleted")
    shown = (Preview.sequence_id == sequence.id, Preview.recording_id.is_(None), Preview.recipe == labels.recipe)
    preview_bytes = sum(session.scalars(delete(Preview).where(*shown).returning(Preview.size_bytes)))
    session.execute(delete(LabelSet).where(LabelSet.id == labels.id))
    for subject_id in subjects:
        storage_quota.release(session, subject_id, "label set deleted")
    storage_quota.count(session, sequence.owner_id, -preview_bytes, sequence.id, "label set deleted")


def label_set_pins(session: Session, sequence: SequenceRow, labels: LabelSet) -> Iterator[str]:
    """Yield the reasons to keep the label set; each sentence names the object that relies on it."""
    exports = select(Export.format).where(Export.label_set_id == labels.id, Export.format != PLAYBACK)
    yield from (f"its export {form} exists" for form in session.scalars(exports.order_by(Export.id)))
    members = select(Dataset.id, Dataset.name).join(DatasetMember, DatasetMember.dataset_id == Dataset.id)
    versions = session.execute(members.where(DatasetMember.label_set_id == labels.id).order_by(Dataset.id)).all()
    yield from (f"version {name} of the dataset contains it" for _, name in versions)
    truths = select(Phase.name).join(GroundTruthRow, GroundTruthRow.phase_id == Phase.id).distinct()
    truths = truths.where(GroundTruthRow.dataset_id.in_([dataset_id for dataset_id, _ in versions]))
    yield from (f"phase {name} uses it as ground truth" for name in session.scalars(truths.order_by(Phase.name)))
    counting = counting_labels(session, sequence.id)
    if counting is None or counting.id != labels.id:
        return
    if sequence.is_public:
        yield f"it is the active label set of {sequence.name}, which is public"
    if session.get(SplitMember, sequence.id) is not None:
        yield f"it is the active label set of {sequence.name}, which is in the draft splits"


@dataclass
class LabelSetWalk:
    """The sweeper's position among the sequences that may have too many label sets."""

    after_id: str = ""


def keep_newest(platform: Platform, walk: LabelSetWalk) -> int:
    """In a few sequences, delete all but the newest `retention.label_sets` sets of each; return the number deleted.

    Label sets on which something relies are kept in addition. If the setting is 0, no label set is deleted.
    """
    kept = platform.settings.retention.label_sets
    if not kept:
        return 0
    having = select(LabelSet.sequence_id).where(LabelSet.sequence_id > walk.after_id).group_by(LabelSet.sequence_id)
    having = having.having(func.count() > kept).order_by(LabelSet.sequence_id).limit(SEQUENCES_AT_A_TIME)
    with platform.database.reading() as session:
        sequence_ids = session.scalars(having).all()
    walk.after_id = sequence_ids[-1] if len(sequence_ids) == SEQUENCES_AT_A_TIME else ""
    deleted = 0
    for sequence_id in sequence_ids:
        with platform.database.transaction() as session, suppress(SequenceDeletedError):
            deleted += _keep_newest_of(session, lock_sequence(session, sequence_id), kept)
    return deleted


def _keep_newest_of(session: Session, sequence: SequenceRow, kept: int) -> int:
    newest = select(LabelSet).where(LabelSet.sequence_id == sequence.id)
    ordered = session.scalars(newest.order_by(LabelSet.chosen_ns.desc(), LabelSet.id.desc())).all()
    unpinned = [labels for labels in ordered if not any(label_set_pins(session, sequence, labels))]
    for labels in unpinned[kept:]:
        append_own(session, "label_set.delete", labels.id, {"sequence_id": sequence.id, "kept": kept})
        delete_label_set(session, labels)
    return len(unpinned[kept:])
