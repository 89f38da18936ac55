"""Messages that two recordings of a run both hold, once their clocks are one: which of them are left out.

**Conventions.** The earlier of the members keeps a message. Indices are those of the recording itself.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from stone.sensors.shared_messages import TopicMessages, repeated_rows, runs_of
from stone_recordings.joining.clock_links import TRANSPORT_NS, ClockOffset
from stone_recordings.joining.held_messages import HeldMessages

Runs = Mapping[str, tuple[tuple[int, int], ...]]


def left_out(held: Sequence[HeldMessages], offsets: Sequence[ClockOffset]) -> tuple[Runs, ...]:
    """For each recording, by topic, the runs of messages that one before it holds, too."""
    moved = [
        {name: _moved(messages, offset, name) for name, messages in recording.messages.items()}
        for recording, offset in zip(held, offsets, strict=True)
    ]
    return tuple(_repeated(moved[:number], moved[number], offsets[number]) for number in range(len(held)))


def _repeated(
    before: Sequence[Mapping[str, TopicMessages]], own: Mapping[str, TopicMessages], offset: ClockOffset
) -> Runs:
    tolerance_ns = max(TRANSPORT_NS, 5 * (offset.sigma_ns or 0))
    found = {}
    for name, messages in own.items():
        rows = [repeated_rows(other[name], messages, tolerance_ns) for other in before if name in other]
        if runs := runs_of(np.unique(np.concatenate(rows)) if rows else np.zeros(0, np.int64)):
            found[name] = runs
    return found


def _moved(messages: TopicMessages, offset: ClockOffset, name: str) -> TopicMessages:
    has_stamp = (messages.stamps_ns != 0) & (name not in offset.kept_topics)
    stamps_ns = messages.stamps_ns + np.where(has_stamp, offset.offset_ns, 0)
    return TopicMessages(messages.log_times_ns + offset.offset_ns, stamps_ns, messages.digests)
