"""Opens a recording of any container, and reads its messages by topic in log-time order.

**Conventions.** Log time is integer nanoseconds. A payload is the whole CDR message with its 4-byte header (for ROS 1
the message as CDR), and stays valid after the bag is closed. `index` counts within the topic, in log-time order.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.sequence import RecordingClock
from stone_files.joined_file import JoinedMember, is_joined, member_path, read_joined
from stone_recordings.bags.containers import opened_store
from stone_recordings.bags.errors import IngestError, encoding_refused
from stone_recordings.bags.joined.joined_store import MovedBag, coverage_findings, joined_store, member_findings
from stone_recordings.bags.members import members_of
from stone_recordings.bags.message_store import Messages, MessageStore, Topic
from stone_recordings.bags.split_store import SplitStore
from stone_recordings.bags.unpacked_messages import is_packed, unpacked, unpacked_head
from stone_recordings.messages.types.definitions_beside import described

__all__ = ["Bag", "MessageStore", "RawMessage", "Topic", "open_bag"]

UNKNOWN_SIZE = 2**63 - 1  # more than any message has: no declaration contradicts it


@dataclass(frozen=True, slots=True)
class RawMessage:
    log_time_ns: int
    index: int
    payload: memoryview


class Bag:
    """An open recording; a context manager."""

    def __init__(
        self,
        path: Path,
        store: MessageStore,
        findings: tuple[Finding, ...] = (),
        members: Sequence[JoinedMember] = (),
    ) -> None:
        topics, noticed = described(store.topics, path) if path.is_dir() else (store.topics, ())
        self.path, self.topics = path, topics
        """Every declared topic, by name; `count` may be 0."""
        self.recordings = tuple(
            RecordingClock(member.name, member.offset_ns, member.sigma_ns, member.known_by) for member in members
        )
        """The joined recordings; () for a single recording."""
        self.findings = (*findings, *store.findings, *noticed)
        self._store = store
        self._topics = {topic.name: topic for topic in topics}
        self._packed: set[str] = set()
        self.is_believed = False

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        self._store.close()

    def release(self) -> None:
        """Release memory and files that can be loaded again; reading continues as before."""
        self._store.release()

    def believe(self) -> None:
        """Assume that nothing is damaged: `heads` checks nothing and `damaged` is empty, which avoids reading
        everything first. The container of a message that is read later is checked all the same, and `damaged_beside`
        checks the rest.
        """
        self.is_believed = True

    def read_sparingly(self) -> None:
        """Assume that the recording is sound, and read only requested messages: it is far away, and most of its bytes
        are pictures. The checksum of an uncompressed chunk is then checked only with a message that is most of the
        chunk.
        """
        self.believe()
        self._store.read_sparingly()

    @property
    def is_indexed(self) -> bool:
        """False if the recording had no usable index and was walked."""
        return self._store.is_indexed

    @cached_property
    def damaged(self) -> Mapping[str, Mapping[int, str]]:
        """By topic and index, the messages in damaged chunks, and the reason; their content is lost.

        The first access reads everything with a checksum or compression. After it, `heads` skips these messages;
        `message` and `messages` always refuse them. Empty for a recording that is assumed to be sound.
        """
        return {} if self.is_believed else self._store.damaged()

    def damaged_beside(self, messages: Messages) -> Mapping[str, Mapping[int, str]]:
        """Return `damaged`, without checking the containers of these messages: reading them checks them."""
        return self._store.damaged(messages)

    def size_bytes(self, topic: str, index: int) -> int:
        """Return the size of a message whose head was just yielded, cheaply; `UNKNOWN_SIZE` if it is packed."""
        self._check_readable(topic)
        return UNKNOWN_SIZE if topic in self._packed else self._store.size_bytes(topic, index)

    @property
    def damage_findings(self) -> tuple[Finding, ...]:
        """Return BAG-016 for each topic with damaged messages."""
        return tuple(
            Finding("BAG-016", "warning", topic, _damage(reasons, self._topics[topic].count))
            for topic, reasons in sorted(self.damaged.items())
        )

    @property
    def start_ns(self) -> int:
        """Log time of the first message; 0 for a recording without messages."""
        return min((int(times[0]) for times in self._all_times()), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the last message; 0 for a recording without messages."""
        return max((int(times[-1]) for times in self._all_times()), default=0)

    def type_of(self, topic: str) -> str:
        """Return the type of a topic's messages. Raises: `BAG-015`."""
        self._check_known(topic)
        return self._topics[topic].type

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        """Return the ascending log times (N,) of one topic."""
        self._check_known(topic)
        return self._store.log_times_ns(topic)

    def messages(self, topic: str, start: int = 0, stop: int | None = None) -> Iterator[RawMessage]:
        """Yield messages `start` to `stop` (half-open indices within the topic) in log-time order.

        Raises: `BAG-015`, `BAG-014`, and for a damaged container its coded refusals.
        """
        self._check_readable(topic)
        times = self._store.log_times_ns(topic)
        for index in range(*slice(start, stop).indices(len(times))):
            yield RawMessage(int(times[index]), index, self._payload(topic, index))

    def message(self, topic: str, index: int) -> RawMessage:
        """Return one message; raises IndexError beyond the topic's count, else as `messages`."""
        self._check_readable(topic)
        times = self._store.log_times_ns(topic)
        position = range(len(times))[index]
        return RawMessage(int(times[position]), position, self._payload(topic, position))

    def payload(self, topic: str, index: int) -> memoryview:
        """Return the payload of one message. Raises: as `message`."""
        return self.message(topic, index).payload

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Yield (topic, index, payload) of all messages, in storage order, for a scan of their first bytes.

        A payload may end after `stone_recordings.bags.message_store.HEAD_BYTES`, except for the topics in `whole`.
        Every chunk is inflated once, whatever the number of topics. Plain chunks are neither read whole nor checked;
        databases are read only up to the pages that hold the heads. If `is_checked`, chunks are read whole, damaged
        ones are skipped, and `damaged` reads none of them again; this does not apply to a recording that is assumed to
        be sound. Raises: as `messages`.
        """
        is_checked &= not self.is_believed
        for topic in topics:
            self._check_readable(topic)
        for topic, index, payload in self._store.heads(topics, whole, is_checked=is_checked):
            yield topic, index, self._head(topic, index, topic in whole) if is_packed(payload) else payload

    def _payload(self, topic: str, index: int) -> memoryview:
        payload = self._store.payload(topic, index)
        return unpacked(payload, self._where(topic, index)) if is_packed(payload) else payload

    def _head(self, topic: str, index: int, is_whole: bool) -> memoryview:
        """Return the head of a packed message, which is read whole, because its first bytes alone may not unpack."""
        self._packed.add(topic)
        unpack = unpacked if is_whole else unpacked_head
        return unpack(self._store.payload(topic, index), self._where(topic, index))

    def _where(self, topic: str, index: int) -> str:
        return f"{self.path.name}, {topic} message {index}"

    def _all_times(self) -> Iterator[NDArray[np.int64]]:
        return (self._store.log_times_ns(topic.name) for topic in self.topics if topic.count)

    def _check_known(self, topic: str) -> None:
        if topic not in self._topics:
            raise unknown_topic(self.path.name, topic, tuple(self._topics))

    def _check_readable(self, topic: str) -> None:
        self._check_known(topic)
        if (encoding := self._topics[topic].encoding) != "cdr":
            raise encoding_refused(self.path.name, topic, encoding)


def _damage(reasons: Mapping[int, str], count: int) -> str:
    chunks = dict.fromkeys(reasons.values())
    return (
        f"{len(reasons)} of {count} messages lie in {len(chunks)} damaged chunks and are left out "
        f"(the first: {next(iter(chunks))})"
    )


def open_bag(path: Path) -> Bag:
    """Open an `.mcap`, `.db3` or ROS 1 `.bag` file, a folder of a split recording, or one of several joined recordings.

    Split and joined bags are one recording; files and messages that the recorder compressed are unpacked on reading.
    `findings` are BAG-021 … BAG-031, for joined bags SYN-520 … SYN-528. Raises: FileNotFoundError, NotABagError
    (BAG-001), CutBagError (BAG-010), MalformedBagError (BAG-012), `BAG-019`, JoinedFileError (BAG-040), `BAG-041` and
    the other `BAG-*` refusals.
    """
    return _joined_bag(path) if is_joined(path) else _plain_bag(path)


def _joined_bag(path: Path) -> Bag:
    members = read_joined(path)
    with ExitStack() as opened:
        bags = (opened.enter_context(_plain_bag(member_path(path, member))) for member in members)
        parts = tuple(MovedBag(bag, member) for bag, member in zip(bags, members, strict=True))
        findings = (*member_findings(members), *coverage_findings(members, parts))
        bag = Bag(path, joined_store(path.name, parts), findings, members)
        opened.pop_all()
    return bag


def _plain_bag(path: Path) -> Bag:
    members = members_of(path)
    with ExitStack() as opened:
        parts: list[MessageStore] = []
        for file in members.files:
            parts.append(opened_store(file))
            opened.callback(parts[-1].close)
            if len(members.files) > 1:
                parts[-1].release()
        store = parts[0] if len(parts) == 1 else SplitStore(path.name, parts)
        bag = Bag(path, store, members.findings)
        opened.pop_all()
    return bag


def unknown_topic(name: str, topic: str, known: tuple[str, ...]) -> IngestError:
    shown = ", ".join(known[:8]) + (", …" if len(known) > 8 else "")
    return IngestError("BAG-015", f"{name} has no topic {topic!r}; it has {shown or 'no topics at all'}")
