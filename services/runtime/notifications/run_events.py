"""The end of a run as an event to its owner.

**Conventions.** Told are runs that somebody asked for and waits for. A submission's run is told of as the submission;
what the platform does by itself (playbacks) and the deliveries of notifications are not told.
"""

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.notifications.events import RUN_DONE, RUN_FAILED, NewEvent, record
from services.runtime.orm import Export, Job

TOLD = {
    "sequence.process": "processing",
    "dataset.import": "the import of a dataset",
    "labeler.export": "the export",
    "dataset.inputs": "creating a dataset's inputs",
    "phase.inputs": "creating a phase's inputs",
    "eval.truth": "creating a ground truth",
    "phase.rescore": "a re-score",
}
"""Runs that are told of, by their kind, in words."""
TOLD_FAILED = {**TOLD, "ingest.register": "reading a recording"}
LONGEST_FAILURE = 500
STOPPED = "cancelled"
"""The code of a run that an administrator stopped."""


def tell_run_succeeded(session: Session, run: Job) -> None:
    """Record that the run is done, where that is told."""
    if run.kind in TOLD and not _is_playback(session, run):
        record(session, NewEvent(RUN_DONE, run.id, user_id=run.owner_id))


def tell_run_failed(session: Session, run: Job, code: str, sentence: str) -> None:
    """Record that the run failed with this code and sentence, where that is told."""
    if run.kind in TOLD_FAILED and not _is_playback(session, run):
        facts = {"code": code, "failure": sentence[:LONGEST_FAILURE]}
        record(session, NewEvent(RUN_FAILED, run.id, user_id=run.owner_id, facts=facts))


def tell_run_stopped(session: Session, run: Job, reason: str) -> None:
    """Record that somebody other than its owner stopped the run, where its failure would be told."""
    tell_run_failed(session, run, STOPPED, reason)


def _is_playback(session: Session, run: Job) -> bool:
    """Whether it makes the small pictures of the viewer, which nobody asks for."""
    format_ = select(Export.format).where(Export.job_id == run.id).limit(1)
    return run.kind == "labeler.export" and session.scalar(format_) == "playback"
