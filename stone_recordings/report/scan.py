"""One pass over the messages of a recording: header stamps, and copies of selected small messages.

**Conventions.** Storage order, so each chunk is inflated once. An unreadable message, or one in a damaged chunk, is
recorded with its problem; a topic without any other message is refused. At most `MOST_KEPT` messages in the middle of a
selected topic are copied, and at most `MOST_KEPT_BYTES` of all topics, in equal shares: memory does not grow with the
recording.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag, Topic
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.clocks.timing import begins_with_header, stamp_of
from stone_recordings.messages.problems import DAMAGED, MALFORMED, MessageProblem
from stone_recordings.report.head_checks import HeadCounts
from stone_recordings.sync.recorded_messages import RecordedReading, RecordedTopics

# Three minutes of a 200 Hz IMU, half an hour of a 20 Hz receiver.
MOST_KEPT = 36_000
MOST_KEPT_BYTES = 48 * 2**20


@dataclass(frozen=True, slots=True)
class KeptMessage:
    payload: memoryview


@dataclass(frozen=True, eq=False)
class Scan:
    """By topic: header stamps (N,) in log order, kept messages in log order, or the reason why the topic was given up.

    `kept_from` is the index in the topic of its first kept message. `problems` are the unreadable messages: their
    stamps are the log times, moved by the others' median distance, and they are never among the kept. `counts` are
    missing values in the heads; `recorded` is synchronisation's reading, if it took part in the same pass.
    """

    stamps_ns: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    kept: Mapping[str, list[KeptMessage]] = field(default_factory=dict)
    kept_from: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, ByteOrderError | MessageLayoutError] = field(default_factory=dict)
    problems: Mapping[str, Mapping[int, MessageProblem]] = field(default_factory=dict)
    counts: Mapping[str, HeadCounts] = field(default_factory=dict)
    recorded: RecordedTopics | None = None


def scan_of(bag: Bag, kept_bytes: Callable[[Topic], int], beside: RecordedReading | None = None) -> Scan:
    """Scan a bag; `kept_bytes` returns how much of a topic's messages to copy, 0 for none.

    `beside` takes its own messages in the same pass. Touches a page per message, never a whole cloud. Raises the
    `BAG-*` refusals.
    """
    stamped = {topic.name: topic for topic in bag.topics if topic.encoding == "cdr" and begins_with_header(topic)}
    stamps_ns = {name: np.zeros(topic.count, np.int64) for name, topic in stamped.items()}
    copied = {name: size for name, topic in stamped.items() if (size := kept_bytes(topic))}
    windows = {name: _middle(stamped[name].count, MOST_KEPT_BYTES // len(copied) // copied[name]) for name in copied}
    kept: dict[str, dict[int, bytes]] = {name: {} for name in windows}
    errors: dict[str, dict[int, ByteOrderError | MessageLayoutError]] = {name: {} for name in stamped}
    counts = {name: HeadCounts() for name in stamped}
    for name, index, payload in _heads(bag, tuple(stamped), beside):
        if name not in stamped:
            continue
        try:
            stamps_ns[name][index] = stamp_of(payload, stamped[name].type)
        except (ByteOrderError, MessageLayoutError) as error:
            errors[name][index] = error
            continue
        counts[name].take(payload, stamped[name].type)
        if name in kept and index in windows[name]:
            kept[name][index] = bytes(payload[: copied[name]])
    refused = {
        name: next(iter(own.values())) for name, own in errors.items() if own and len(own) == stamped[name].count
    }
    damaged = bag.damaged  # this reads damaged chunks of other topics alone, which the pass did not meet
    problems = {name: _problems(errors[name], damaged.get(name, {})) for name in stamped if name not in refused}
    for name, own in problems.items():
        stamps_ns[name] = _filled(stamps_ns[name], bag.log_times_ns(name), list(own))
    return Scan(
        {name: stamps for name, stamps in stamps_ns.items() if name not in refused},
        {name: _messages(payloads) for name, payloads in kept.items() if name not in refused},
        {name: window.start for name, window in windows.items()},
        refused,
        problems,
        {name: own for name, own in counts.items() if name not in refused},
        beside.finished() if beside else None,
    )


def _heads(bag: Bag, names: tuple[str, ...], beside: RecordedReading | None) -> Iterator[tuple[str, int, memoryview]]:
    """Yield the heads of the named topics; `beside` takes its own in the same pass."""
    if beside is None:
        yield from bag.heads(names, is_checked=True)
        return
    used = tuple(dict.fromkeys((*names, *beside.used)))
    for name, index, payload in bag.heads(used, whole=beside.whole, is_checked=True):
        beside.take(name, index, payload)
        yield name, index, payload


def _problems(
    errors: Mapping[int, ByteOrderError | MessageLayoutError], damaged: Mapping[int, str]
) -> dict[int, MessageProblem]:
    return {index: MessageProblem(MALFORMED, str(error)) for index, error in errors.items()} | {
        index: MessageProblem(DAMAGED, why) for index, why in damaged.items()
    }


def _filled(stamps_ns: NDArray[np.int64], log_times_ns: NDArray[np.int64], missing: list[int]) -> NDArray[np.int64]:
    """Return the stamps, with those that the missing ones would have by the recorder's clock."""
    if not missing or len(missing) == len(stamps_ns):
        return stamps_ns
    apart_ns = int(np.median(np.delete(stamps_ns - log_times_ns, missing)))
    filled = stamps_ns.copy()
    filled[missing] = log_times_ns[missing] + apart_ns
    return filled


def _middle(count: int, most: int) -> range:
    """Return the indices that are kept."""
    most = min(most, MOST_KEPT)
    first = max(0, (count - most) // 2)
    return range(first, min(count, first + most))


def _messages(payloads: Mapping[int, bytes]) -> list[KeptMessage]:
    return [KeptMessage(memoryview(payloads[index])) for index in sorted(payloads)]
