"""Exports: label sets of a sequence written in other formats by jobs.

**Conventions.** An export is one label set in one format. Equal requests share one export (`recipe`), so an unchanged
sequence is not written again. New labels make earlier exports stale; stale exports stay until they are deleted. Each
function is part of the caller's transaction and locks the sequence's row first
(`services/domain/sequences/processing.py`). The bytes count against the sequence's owner under the export's id.
Signed-in users may download finished exports of sequences that are visible to them. A sequence with hidden frames is
visible only to its owner, since an export contains all labels (`api/visible.py`). Single files of a playback are
visible with the sequence.
"""

from collections.abc import Sequence as Listing
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, get_args

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.sequences.label_sources import has_samples
from services.domain.sequences.processing import lock_sequence
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.runtime.access import storage_quota
from services.runtime.code_version import code_version
from services.runtime.jobs.control import cancel
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.errors import JobCancelledError, JobStateError, QueueDrainingError
from services.runtime.jobs.specs import TERMINAL, Attempt, Context, JobSpec
from services.runtime.orm import (
    Artefact,
    Export,
    ExportPack,
    Job,
    LabelSet,
    SequenceRow,
    new_id,
)
from services.runtime.orm.base import now_ns
from services.runtime.store.blobs import PreparedBlob, link_all
from services.runtime.store.packs import PackedFiles
from services.runtime.store.recipes import recipe_of
from services.runtime.telemetry.tracing import link_job
from stone.errors import Refused

EXPORT = "labeler.export"
ExportFormat = Literal["nuscenes", "inputs", "kitti", "mesh", "mcap", "rrd", "previews", "playback"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
FROM_LABELS_ALONE = ("mesh",)
LAST = -1  # the priority of jobs without a waiting user


@dataclass(frozen=True, eq=False)
class ExportResult:
    """The product of an export job: stored blobs, and size and sha256 of the archives of the files."""

    files: PackedFiles
    index: PreparedBlob
    packs: Listing[PreparedBlob]
    tar: tuple[int, str]
    zip: tuple[int, str]

    @property
    def size_bytes(self) -> int:
        """The bytes of the export in the store."""
        return self.index.size_bytes + sum(pack.size_bytes for pack in self.packs)


def start_export(session: Session, sequence: SequenceRow, form: str) -> tuple[Export, Job]:
    """Return the export of the active labels and its job, existing or new.

    An export whose job failed or was cancelled is retried. Raises `unknown_format`, `SequenceDeletedError`,
    `nothing_to_export`, `QueueDrainingError`.
    """
    if form not in FORMATS:
        raise Refused("unknown_format", f"{form[:80]!r} is not an export format; the formats are {', '.join(FORMATS)}")
    sequence = lock_sequence(session, sequence.id)
    labels = _exportable_labels(session, sequence, form)
    link_job(session, labels.job_id)
    recipe = _recipe(labels, form)
    export = _existing_export(session, sequence, recipe)
    if export is not None:
        job = session.get_one(Job, export.job_id, populate_existing=True)
        if export.finished_ns is not None or (job.state not in TERMINAL and not job.cancel_reason):
            return export, job
    else:
        export = _new_export(labels, form, recipe)
    return export, _enqueue_export(session, export, Context(sequence.owner_id, sequence.id))


def follow_labels(session: Session, sequence: SequenceRow, labels: LabelSet, form: str) -> None:
    """Queue an automatic export of labels that are being published, with lower priority than user requests.

    If the queue is draining or the measurements were deleted, nothing is queued. The sequence is not locked: deletion
    waits for the publishing run and then finds the export.
    """
    if has_samples(session, sequence.id, labels.id):
        export = _new_export(labels, form, _recipe(labels, form))
        with suppress(QueueDrainingError):
            _enqueue_export(session, export, Context(sequence.owner_id, sequence.id, LAST))


def write_export(session: Session, attempt: Attempt, made: ExportResult, limit_bytes: int) -> None:
    """Write the job's result in the transaction of its success; `limit_bytes` is the owner's total quota.

    Raises `JobCancelledError` if the export was deleted or belongs to another job, `quota_exceeded`.
    """
    sequence = require_sequence(session, attempt)
    export = exported_by(session, attempt)
    link_all(session, (made.index, *made.packs))
    for ordinal, pack in enumerate(made.packs):
        session.add(
            ExportPack(export_id=export.id, ordinal=ordinal, blob_sha256=pack.sha256, size_bytes=pack.size_bytes)
        )
    export.index_sha256, export.files, export.finished_ns = made.index.sha256, len(made.files), now_ns()
    export.size_bytes = int(made.files.sizes_bytes.sum())
    export.tar_bytes, export.tar_sha256 = made.tar
    export.zip_bytes, export.zip_sha256 = made.zip
    session.flush()
    storage_quota.reserve(session, sequence.owner_id, made.size_bytes, export.id, "export", limit_bytes)


def exported_by(session: Session, attempt: Attempt) -> Export:
    """Return the attempt's export. Raises `JobCancelledError`."""
    export = session.get(Export, attempt.arguments["export_id"], populate_existing=True)
    if export is None or export.job_id != attempt.job_id:
        raise JobCancelledError("its export was deleted, or another job writes it")
    return export


def begin_export(session: Session, attempt: Attempt) -> Export:
    """Return the attempt's export at its start, and assign it to this version of the code.

    Its recipe stays if an export by this version was requested meanwhile. Raises `JobCancelledError`,
    `SequenceDeletedError`.
    """
    export = exported_by(session, attempt)
    if export.code_version == code_version("exports"):
        return export
    sequence = lock_sequence(session, export.sequence_id)
    export = exported_by(session, attempt)
    recipe = _recipe(session.get_one(LabelSet, export.label_set_id), export.format)
    export.code_version = code_version("exports")
    if _existing_export(session, sequence, recipe) is None:
        export.recipe = recipe
    return export


def delete_export(session: Session, export: Export) -> None:
    """Delete an export, finished or not; its blobs are collected later. Raises `SequenceDeletedError`."""
    lock_sequence(session, export.sequence_id)
    with suppress(JobStateError):  # the job has ended
        cancel(session, export.job_id, "its export was deleted")
    session.execute(delete(Export).where(Export.id == export.id))
    storage_quota.release(session, export.id, "export deleted")


def counting_labels(session: Session, sequence_id: str) -> LabelSet | None:
    """Return the active labels: the most recently requested set."""
    newest = select(LabelSet).where(LabelSet.sequence_id == sequence_id)
    return session.scalars(newest.order_by(LabelSet.chosen_ns.desc(), LabelSet.id.desc()).limit(1)).one_or_none()


def _recipe(labels: LabelSet, form: str) -> str:
    return recipe_of("exports", {"labels": labels.recipe, "format": form})


def _new_export(labels: LabelSet, form: str, recipe: str) -> Export:
    facts = {"label_set_id": labels.id, "format": form, "recipe": recipe, "code_version": code_version("exports")}
    return Export(id=new_id(), sequence_id=labels.sequence_id, **facts)


def _enqueue_export(session: Session, export: Export, context: Context) -> Job:
    """Queue and return the job that writes the export. Raises `QueueDrainingError`, and then writes nothing."""
    job = enqueue(session, JobSpec(EXPORT, {"export_id": export.id}), context)
    export.job_id = job.id
    session.add(export)
    session.flush()
    return job


def _existing_export(session: Session, sequence: SequenceRow, recipe: str) -> Export | None:
    same = select(Export).where(Export.sequence_id == sequence.id, Export.recipe == recipe)
    return session.scalars(same.execution_options(populate_existing=True)).one_or_none()


def _exportable_labels(session: Session, sequence: SequenceRow, form: str) -> LabelSet:
    """Return the labels to export. Raises `nothing_to_export`."""
    labels = counting_labels(session, sequence.id)
    if labels is None:
        raise Refused(
            "nothing_to_export",
            f"sequence {sequence.id} cannot be exported: it has no labels; process the sequence first",
        )
    synchronised = select(Artefact.id).where(Artefact.label_set_id == labels.id, Artefact.name == SEQUENCE_FILE)
    if session.scalar(synchronised) is None:
        raise Refused(
            "nothing_to_export",
            f"sequence {sequence.id} cannot be exported: an earlier version labelled it and kept no sequence.npz; "
            "process the sequence again",
        )
    if form not in FROM_LABELS_ALONE and not has_samples(session, sequence.id, labels.id):
        raise Refused(
            "nothing_to_export",
            f"sequence {sequence.id} cannot be exported: its recording was deleted; without a recording only the mesh "
            "can be exported",
        )
    return labels
