"""Recordings added to a labelled sequence: it is automatically processed again, with its last request.

**Conventions.** Due sequences are computed from the rows each time, so no state is lost with a process. A sequence with
labels is due if its last run has ended and used all recordings, and a registered recording was not in that run. No
recording may still be being read. Recordings added together thus cause one run, a refused recording causes none, and a
failed run is not retried.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.chosen_recordings import REGISTERED, recording_ids_of
from services.domain.sequences.processing import (
    PROCESS,
    checked_inputs,
    lock_sequence,
    pending_recordings,
    request_of,
    start_processing,
)
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, LabelSet, Recording, SequenceRow
from services.runtime.platform import Platform
from stone.errors import PlatformFaultError, StoneError

AT_A_TIME = 500
"""Recordings checked per turn."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LaterRecordings:
    """Names of registered recordings that are not in the sequence's labels; `why_not` is set if no run is due."""

    names: tuple[str, ...]
    why_not: str = ""


@dataclass
class SequenceWalk:
    """The sequence, in the order of ids, after which the next turn continues; "" restarts."""

    after: str = ""


def follow_recordings(platform: Platform, walk: SequenceWalk | None = None) -> int:
    """Process sequences with added recordings again, a limited number per turn; return the number of started runs."""
    walk = walk or SequenceWalk()
    with platform.database.reading() as session:
        due = [sequence_id for sequence_id in _with_several(session, walk) if _lacks(session, sequence_id)]
    return sum(_processed_again(platform, sequence_id) for sequence_id in due)


def later_recordings(session: Session, sequence: SequenceRow, labels: LabelSet) -> LaterRecordings | None:
    """Return the recordings that are missing in these labels; None if no recording is missing."""
    names = _unused_recordings(session, sequence.id, session.get(Job, labels.job_id))
    if not names:
        return None
    last = _last_run(session, sequence.id)
    if last is None or last.state not in TERMINAL or pending_recordings(session, sequence):
        return LaterRecordings(names)
    if not _unused_recordings(session, sequence.id, last):
        return LaterRecordings(names, f"the run with these recordings, {last.id}, {last.state}: {last.failure}"[:500])
    try:
        checked_inputs(session, sequence, request_of(last.arguments))
    except StoneError as error:
        return LaterRecordings(names, str(error))
    return LaterRecordings(names)


def _processed_again(platform: Platform, sequence_id: str) -> bool:
    """Return whether a run was started; if it is refused, the next turn tries again."""
    try:
        with platform.database.transaction() as session:
            sequence = lock_sequence(session, sequence_id)
            last = _last_run(session, sequence_id)
            if last is None or last.state not in TERMINAL or pending_recordings(session, sequence):
                return False
            if not _unused_recordings(session, sequence_id, last):
                return False
            run = start_processing(session, sequence, request_of(last.arguments))
            log.info("processed again for later recordings", sequence_id=sequence_id, job_id=run.id)
    except PlatformFaultError:
        raise
    except StoneError as error:
        log.info("not processed again yet", sequence_id=sequence_id, code=error.code, reason=str(error)[:500])
        return False
    return True


def _with_several(session: Session, walk: SequenceWalk) -> list[str]:
    """Return the sequences with several recordings among the next recordings, and advance the walk."""
    ordered = select(Recording.sequence_id).where(Recording.sequence_id > walk.after).order_by(Recording.sequence_id)
    sequence_ids = list(session.scalars(ordered.limit(AT_A_TIME)))
    is_last = len(sequence_ids) < AT_A_TIME
    if not is_last and sequence_ids[0] != sequence_ids[-1]:  # the last sequence may continue beyond the limit
        sequence_ids = [sequence_id for sequence_id in sequence_ids if sequence_id != sequence_ids[-1]]
    walk.after = "" if is_last else sequence_ids[-1]
    return sorted({first for first, other in pairwise(sequence_ids) if first == other})


def _lacks(session: Session, sequence_id: str) -> bool:
    """Return whether a recording is newer than the sequence's newest labels; a cheap check, repeated under locks."""
    newest = select(LabelSet).where(LabelSet.sequence_id == sequence_id).order_by(LabelSet.id.desc()).limit(1)
    labels = session.scalars(newest).one_or_none()
    return labels is not None and bool(_unused_recordings(session, sequence_id, session.get(Job, labels.job_id)))


def _last_run(session: Session, sequence_id: str) -> Job | None:
    runs = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id, Job.kind == PROCESS)
    return session.scalars(
        runs.order_by(Job.id.desc()).limit(1).execution_options(populate_existing=True)
    ).one_or_none()


def _unused_recordings(session: Session, sequence_id: str, run: Job | None) -> tuple[str, ...]:
    """Return the names of the registered recordings that the run did not use.

    Empty if the run's owner selected recordings, or if the labels were made without recordings.
    """
    if (
        run is None
        or run.kind != PROCESS
        or run.arguments.get("names_recordings")
        or not recording_ids_of(run.arguments)
    ):
        return ()
    used = _contents(session, run.arguments)
    of_sequence = select(Recording.filename, Recording.sha256).where(Recording.sequence_id == sequence_id)
    registered = session.execute(of_sequence.where(Recording.state == REGISTERED).order_by(Recording.id))
    return tuple(name for name, sha256 in registered if sha256 not in used)


def _contents(session: Session, arguments: Mapping[str, Any]) -> set[str]:
    """Return the hashes of the run's recordings; runs of an earlier version have no hashes in their arguments."""
    known: Sequence[str] | None = arguments.get("recording_sha256s")
    if known is not None:
        return set(known)
    rows: Iterable[str] = session.scalars(select(Recording.sha256).where(Recording.id.in_(recording_ids_of(arguments))))
    return set(rows)
