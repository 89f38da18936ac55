"""Which recordings a run is made of, and offsets of their clocks that its owner knows.

**Conventions.** Recordings of one content are one, whatever they are called; the first that was added stands for them.
Members of a run are told apart by their names, so no two are called alike. An offset is added to a recording's times.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.sequences.processing_errors import (
    ClockOffsetError,
    NoRecordingError,
    RecordingNamesError,
    UnknownRecordingError,
)
from services.runtime.orm import Recording, SequenceRow

REGISTERED = "registered"


def chosen_recordings(session: Session, sequence: SequenceRow, ids: Sequence[str]) -> tuple[Recording, ...]:
    """The registered recordings of the sequence with these ids, or all of them, in the order in which they were added.

    Raises `UnknownRecordingError`, `NoRecordingError`, `RecordingNamesError`.
    """
    of_sequence = select(Recording).where(Recording.sequence_id == sequence.id).order_by(Recording.id)
    recordings = session.scalars(of_sequence.execution_options(populate_existing=True)).all()
    registered = {recording.id: recording for recording in recordings if recording.state == REGISTERED}
    if unknown := sorted(set(ids) - set(registered)):
        raise UnknownRecordingError(sequence.id, unknown[0])
    if not registered:
        raise NoRecordingError(sequence.id, len(recordings))
    chosen = [recording for recording in registered.values() if not ids or recording.id in ids]
    return _told_apart(sequence, chosen)


def offsets_by_name(recordings: Sequence[Recording], given_ns: Mapping[str, int]) -> dict[str, int]:
    """The offsets by name of recording; they are given by id or name. Raises `ClockOffsetError`."""
    if given_ns and len(recordings) == 1:
        raise ClockOffsetError(next(iter(given_ns)), "the run has one recording, which has no other clock to be put on")
    names = {key: recording.filename for recording in recordings for key in (recording.id, recording.filename)}
    found = dict[str, int]()
    for key, offset_ns in sorted(given_ns.items()):
        if key not in names:
            known = ", ".join(sorted(recording.filename for recording in recordings))
            raise ClockOffsetError(key, f"it is none of the run's recordings, which are {known}")
        if found.setdefault(names[key], offset_ns) != offset_ns:
            raise ClockOffsetError(key, "two different offsets are given for it, by its id and by its name")
    return found


def recording_ids_of(arguments: Mapping[str, Any]) -> tuple[str, ...]:
    """The recordings that a run with these arguments reads; an earlier version named one."""
    named = arguments.get("recording_ids") or [arguments.get("recording_id")]
    return tuple(one for one in named if one is not None)


def _told_apart(sequence: SequenceRow, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    by_content = {recording.sha256: recording for recording in reversed(recordings)}
    apart = sorted(by_content.values(), key=lambda recording: recording.id)
    names = [recording.filename.casefold() for recording in apart]
    for recording in apart:
        if names.count(recording.filename.casefold()) > 1:
            raise RecordingNamesError(sequence.id, recording.filename)
    return tuple(apart)
