"""Recordings that are added to a labelled sequence later: it is processed again by itself, with its last request.

**Conventions.** What is due is read from the rows each time and remembered nowhere, so that nothing is lost with a
process: labels are there, the last run has ended and was meant to take all recordings, one was registered that it had
not, and none is still being read. So of recordings that are added at once one run is made, of one that is refused none,
and one that fails is not tried again.
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
"""Recordings that a turn looks at."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LaterRecordings:
    """Names of registered recordings that the labels of a sequence were not made of; `why_not` where no run is due."""

    names: tuple[str, ...]
    why_not: str = ""


@dataclass
class SequenceWalk:
    """After which sequence, in the order of ids, the next turn looks on; "" begins again."""

    after: str = ""


def follow_recordings(platform: Platform, walk: SequenceWalk | None = None) -> int:
    """Have sequences processed again to which recordings were added, some in a turn; how many runs were started."""
    walk = walk or SequenceWalk()
    with platform.database.reading() as session:
        due = [sequence_id for sequence_id in _with_several(session, walk) if _lacks(session, sequence_id)]
    return sum(_processed_again(platform, sequence_id) for sequence_id in due)


def later_recordings(session: Session, sequence: SequenceRow, labels: LabelSet) -> LaterRecordings | None:
    """The recordings that these labels of the sequence were not made of; None where there are none to be meant."""
    names = _unused(session, sequence.id, session.get(Job, labels.job_id))
    if not names:
        return None
    last = _last_run(session, sequence.id)
    if last is None or last.state not in TERMINAL or pending_recordings(session, sequence):
        return LaterRecordings(names)
    if not _unused(session, sequence.id, last):
        return LaterRecordings(names, f"the run with these recordings, {last.id}, {last.state}: {last.failure}"[:500])
    try:
        checked_inputs(session, sequence, request_of(last.arguments))
    except StoneError as error:
        return LaterRecordings(names, str(error))
    return LaterRecordings(names)


def _processed_again(platform: Platform, sequence_id: str) -> bool:
    """Whether a run was started; not where that is refused, which is looked at again in the next turn."""
    try:
        with platform.database.transaction() as session:
            sequence = lock_sequence(session, sequence_id)
            last = _last_run(session, sequence_id)
            if last is None or last.state not in TERMINAL or pending_recordings(session, sequence):
                return False
            if not _unused(session, sequence_id, last):
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
    """The sequences of the next recordings that have several of them; the walk goes on."""
    ordered = select(Recording.sequence_id).where(Recording.sequence_id > walk.after).order_by(Recording.sequence_id)
    found = list(session.scalars(ordered.limit(AT_A_TIME)))
    is_last = len(found) < AT_A_TIME
    if not is_last and found[0] != found[-1]:  # the last may go on
        found = [sequence_id for sequence_id in found if sequence_id != found[-1]]
    walk.after = "" if is_last else found[-1]
    return sorted({one for one, other in pairwise(found) if one == other})


def _lacks(session: Session, sequence_id: str) -> bool:
    """Whether its newest labels were made before one of its recordings: quick to say, looked at again under locks."""
    newest = select(LabelSet).where(LabelSet.sequence_id == sequence_id).order_by(LabelSet.id.desc()).limit(1)
    labels = session.scalars(newest).one_or_none()
    return labels is not None and bool(_unused(session, sequence_id, session.get(Job, labels.job_id)))


def _last_run(session: Session, sequence_id: str) -> Job | None:
    runs = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id, Job.kind == PROCESS)
    return session.scalars(
        runs.order_by(Job.id.desc()).limit(1).execution_options(populate_existing=True)
    ).one_or_none()


def _unused(session: Session, sequence_id: str, run: Job | None) -> tuple[str, ...]:
    """Names of the registered recordings that the run had not.

    None of a run whose owner named those that are meant, and of labels that were made of no recording.
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
    """Hashes of what the run was made of; an earlier version kept none in its arguments."""
    known: Sequence[str] | None = arguments.get("recording_sha256s")
    if known is not None:
        return set(known)
    rows: Iterable[str] = session.scalars(select(Recording.sha256).where(Recording.id.in_(recording_ids_of(arguments))))
    return set(rows)
