"""The recordings of a run, and clock offsets given by their owner.

**Conventions.** Recordings with equal content count once, whatever their names; the first one is used. A run's
recordings are identified by their names, which must differ. An offset is added to a recording's times.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Recording, SequenceRow
from stone.errors import Refused

REGISTERED = "registered"


def chosen_recordings(session: Session, sequence: SequenceRow, ids: Sequence[str]) -> tuple[Recording, ...]:
    """Return the registered recordings with these ids, or all of the sequence's, in the order of their creation.

    Raises `unknown_recording`, `no_recording`, `recordings_named_alike`.
    """
    of_sequence = select(Recording).where(Recording.sequence_id == sequence.id).order_by(Recording.id)
    recordings = session.scalars(of_sequence.execution_options(populate_existing=True)).all()
    registered = {recording.id: recording for recording in recordings if recording.state == REGISTERED}
    if unknown := sorted(set(ids) - set(registered)):
        raise Refused(
            "unknown_recording",
            f"sequence {sequence.id} has no registered recording {unknown[0][:80]}; was it removed or refused?",
        )
    if not registered:
        raise no_recording(sequence.id, len(recordings))
    chosen = [recording for recording in registered.values() if not ids or recording.id in ids]
    return _require_distinct_names(sequence, chosen)


def offsets_by_name(recordings: Sequence[Recording], given_ns: Mapping[str, int]) -> dict[str, int]:
    """Return the offsets by recording name; `given_ns` has ids or names as keys. Raises `bad_clock_offset`."""
    if given_ns and len(recordings) == 1:
        raise Refused(
            "bad_clock_offset",
            f"a clock offset is given for {next(iter(given_ns))[:120]}, but the run has only one recording, so there "
            "is no other clock to align it with",
        )
    names = {key: recording.filename for recording in recordings for key in (recording.id, recording.filename)}
    offsets = dict[str, int]()
    for key, offset_ns in sorted(given_ns.items()):
        if key not in names:
            known = ", ".join(sorted(recording.filename for recording in recordings))
            raise Refused(
                "bad_clock_offset",
                f"a clock offset is given for {key[:120]}, but the recordings of the run are {known}",
            )
        if offsets.setdefault(names[key], offset_ns) != offset_ns:
            raise Refused(
                "bad_clock_offset",
                f"two different clock offsets are given for {key[:120]}, one by its id and one by its name",
            )
    return offsets


def recording_ids_of(arguments: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the ids of the recordings that a run with these arguments reads; an earlier version stored one id."""
    named = arguments.get("recording_ids") or [arguments.get("recording_id")]
    return tuple(recording_id for recording_id in named if recording_id is not None)


def _require_distinct_names(sequence: SequenceRow, recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    by_content = {recording.sha256: recording for recording in reversed(recordings)}
    apart = sorted(by_content.values(), key=lambda recording: recording.id)
    names = [recording.filename.casefold() for recording in apart]
    for recording in apart:
        if names.count(recording.filename.casefold()) > 1:
            raise Refused(
                "recordings_named_alike",
                f"two different recordings of sequence {sequence.id} are called {recording.filename[:120]}, but the "
                "recordings of a run need different names. Remove one and upload it under another name, or select "
                "the recordings with recording_ids",
            )
    return tuple(apart)


def no_recording(sequence_id: str, unusable: int) -> Refused:
    why = f"{unusable} could not be registered, see their findings" if unusable else "none was added"
    return Refused("no_recording", f"sequence {sequence_id} has no registered recording ({why}); add a recording first")
