"""Comparisons of two label sets of a sequence: requested, computed by a job, stored once.

**Conventions.** Frames are matched by equal stamps in whole microseconds, since published datasets lack nanoseconds.
Equal requests share one comparison, because label sets never change; a comparison whose job failed or was cancelled is
retried. Each function is part of the caller's transaction.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.processing import lock_sequence
from services.runtime.access import storage_quota
from services.runtime.code_version import code_version
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import TERMINAL, Attempt, Context, JobSpec
from services.runtime.orm import (
    Artefact,
    Blob,
    Job,
    LabelComparison,
    LabelledFrameRow,
    LabelSet,
    SequenceRow,
    new_id,
)
from services.runtime.orm.base import now_ns
from stone.errors import Refused
from stone_base.label_grid import recorded_grid, require_one_geometry

COMPARE = "eval.compare"
NS_PER_US = 1000


@dataclass(frozen=True)
class StoredLabelFile:
    """A frame's label file: a range of an object, and its hash."""

    token: str
    object_key: str
    offset_bytes: int
    length_bytes: int
    sha256: str

    @property
    def span(self) -> tuple[int, int]:
        """The half-open byte range within the object."""
        return self.offset_bytes, self.offset_bytes + self.length_bytes


@dataclass(frozen=True)
class StoredPair:
    """The label files of a frame in A and in B."""

    a: StoredLabelFile
    b: StoredLabelFile


def start_comparison(session: Session, sequence: SequenceRow, a_id: str, b_id: str) -> tuple[LabelComparison, Job]:
    """Return the comparison of A and B and its job, existing or new.

    Raises `unknown_label_set`, `same_label_set`, `grids_differ`, `SequenceDeletedError`, `QueueDrainingError`.
    """
    sequence = lock_sequence(session, sequence.id)
    for label_set_id in (a_id, b_id):
        _require_label_set(session, sequence, label_set_id)
    if a_id == b_id:
        raise Refused("same_label_set", f"A and B are both label set {a_id}; name two different label sets")
    _require_one_grid(session, a_id, b_id)
    comparison = _existing_comparison(session, a_id, b_id)
    if comparison is not None:
        job = session.get_one(Job, comparison.job_id, populate_existing=True)
        if comparison.finished_ns is not None or (job.state not in TERMINAL and not job.cancel_reason):
            return comparison, job
    else:
        facts = {"sequence_id": sequence.id, "a_id": a_id, "b_id": b_id, "code_version": code_version("comparisons")}
        comparison = LabelComparison(id=new_id(), **facts)
    job = enqueue(session, JobSpec(COMPARE, {"comparison_id": comparison.id}), Context(sequence.owner_id, sequence.id))
    comparison.job_id = job.id
    session.add(comparison)
    session.flush()
    return comparison, job


def _require_one_grid(session: Session, a_id: str, b_id: str) -> None:
    """Raise `grids_differ` if the two label sets have different grids."""
    a, b = (recorded_grid(session.get_one(LabelSet, label_set_id).grid) for label_set_id in (a_id, b_id))
    require_one_geometry(a, b)


def compared_by(session: Session, attempt: Attempt) -> LabelComparison:
    """Return the attempt's comparison. Raises `JobCancelledError`."""
    comparison = session.get(LabelComparison, attempt.arguments["comparison_id"], populate_existing=True)
    if comparison is None or comparison.job_id != attempt.job_id:
        raise JobCancelledError("its comparison was deleted, or another job computes it")
    return comparison


def write_comparison(session: Session, attempt: Attempt, record: Mapping[str, Any]) -> None:
    """Write the job's counts in the transaction of its success. Raises `JobCancelledError`."""
    comparison = compared_by(session, attempt)
    comparison.record, comparison.finished_ns = dict(record), now_ns()
    owner_id = session.get_one(SequenceRow, comparison.sequence_id).owner_id
    storage_quota.count(session, owner_id, len(json.dumps(comparison.record)), comparison.id, "label comparison")


def stored_pairs(session: Session, comparison: LabelComparison) -> list[StoredPair]:
    """Return the frames that both label sets have, in the order of A."""
    of_b = _by_microsecond(session, comparison.b_id)
    of_a = _by_microsecond(session, comparison.a_id)
    return [StoredPair(file, of_b[stamp_us]) for stamp_us, file in of_a.items() if stamp_us in of_b]


def stored_pair(session: Session, comparison: LabelComparison, token: str) -> StoredPair | None:
    """Return the pair of a frame with this token in A or in B (tokens may differ), or None if one set lacks it."""
    ids = (comparison.a_id, comparison.b_id)
    named = select(LabelledFrameRow.stamp_ns).where(LabelledFrameRow.token == token)
    stamp_ns = session.scalar(named.where(LabelledFrameRow.label_set_id.in_(ids)).limit(1))
    if stamp_ns is None:
        return None
    pair = [_frame_at(session, label_set_id, stamp_ns) for label_set_id in ids]
    files = [_stored(row, _object_key(session, row)) for row in pair if row is not None]
    return StoredPair(*files) if len(files) == len(pair) else None


def stored_frame(session: Session, labels: LabelSet, token: str) -> StoredLabelFile | None:
    """Return a frame of a label set by its token in any set of the sequence, or None if the set lacks it."""
    named = select(LabelledFrameRow.stamp_ns).join(LabelSet, LabelSet.id == LabelledFrameRow.label_set_id)
    of_sequence = named.where(LabelledFrameRow.token == token, LabelSet.sequence_id == labels.sequence_id)
    stamp_ns = session.scalar(of_sequence.limit(1))
    row = None if stamp_ns is None else _frame_at(session, labels.id, stamp_ns)
    return None if row is None else _stored(row, _object_key(session, row))


def _frame_at(session: Session, label_set_id: str, stamp_ns: int) -> LabelledFrameRow | None:
    """Return the first frame of the set in the microsecond of this stamp."""
    first_ns = stamp_ns // NS_PER_US * NS_PER_US
    same = LabelledFrameRow.stamp_ns.between(first_ns, first_ns + NS_PER_US - 1)
    frames = select(LabelledFrameRow).where(LabelledFrameRow.label_set_id == label_set_id, same)
    return session.scalars(frames.order_by(LabelledFrameRow.ordinal).limit(1)).one_or_none()


def _by_microsecond(session: Session, label_set_id: str) -> dict[int, StoredLabelFile]:
    """Return the label files of a set by whole microsecond, in the order of frames; the first file of each."""
    frames = (
        select(LabelledFrameRow, Blob.object_key)
        .join(Artefact, Artefact.id == LabelledFrameRow.pack_id)
        .join(Blob, Blob.sha256 == Artefact.blob_sha256)
        .where(LabelledFrameRow.label_set_id == label_set_id)
        .order_by(LabelledFrameRow.ordinal)
    )
    files = dict[int, StoredLabelFile]()
    for row, key in session.execute(frames):
        files.setdefault(row.stamp_ns // NS_PER_US, _stored(row, key))
    return files


def _object_key(session: Session, row: LabelledFrameRow) -> str:
    return session.get_one(Blob, session.get_one(Artefact, row.pack_id).blob_sha256).object_key


def _stored(row: LabelledFrameRow, object_key: str) -> StoredLabelFile:
    return StoredLabelFile(row.token, object_key, row.offset_bytes, row.length_bytes, row.sha256)


def _existing_comparison(session: Session, a_id: str, b_id: str) -> LabelComparison | None:
    same = select(LabelComparison).where(LabelComparison.a_id == a_id, LabelComparison.b_id == b_id)
    same = same.where(LabelComparison.code_version == code_version("comparisons"))
    return session.scalars(same.execution_options(populate_existing=True)).one_or_none()


def _require_label_set(session: Session, sequence: SequenceRow, label_set_id: str) -> None:
    """Return the label set of the sequence. Raises `unknown_label_set`."""
    labels = session.get(LabelSet, label_set_id)
    if labels is None or labels.sequence_id != sequence.id:
        raise Refused(
            "unknown_label_set",
            f"sequence {sequence.id} has no label set {label_set_id[:80]!r}; does it belong to another sequence?",
        )
