"""The interface of message stores: what every container format implements.

**Conventions.** As `stone_recordings.bags.bag`. A store is told by `release` that it will rest for a while, and by
`close` that it is over; payloads stay valid after both.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding

# A topic of a recording: its name, its type and how its payloads are written.
#
# **Conventions.** `type` is written `package/msg/Name`; `schema` is the ros2msg text embedded in the recording, ""
# where none is; `encoding` is how payloads are written.


@dataclass(frozen=True)
class Topic:
    name: str
    type: str
    count: int
    schema: str
    encoding: str = "cdr"


# A scan of headers reads no further into a message than this, so that clouds stay on the disk.
HEAD_BYTES = 8192

Messages = Mapping[str, NDArray[np.int64]]  # by topic, indices in it
NO_MESSAGES: Messages = MappingProxyType({})


class MessageStore(Protocol):
    """An MCAP file, a database, or several of them."""

    topics: tuple[Topic, ...]
    is_indexed: bool
    findings: tuple[Finding, ...]

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        """Ascending log times of the topic's messages."""
        ...

    def payload(self, topic: str, index: int) -> memoryview:
        """The CDR message at `index` in log-time order."""
        ...

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Topic, index and at least the first `HEAD_BYTES` of every message (all of one that is shorter, or whose
        topic is among `whole`), in the order in which they are stored. What is damaged is passed over where that
        `is_checked`, and where `damaged` was asked before.
        """
        ...

    def size_bytes(self, topic: str, index: int) -> int:
        """Of the message as it is stored; cheap for one whose head was just given."""
        ...

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        """By topic and index, messages that cannot be had because what they lie in is damaged, and why.

        Reads whatever carries a checksum or is compressed, once; from then on `heads` passes these messages over.
        What the messages `beside` lie in is not looked at.
        """
        ...

    def read_sparingly(self) -> None:
        """From now on read no bytes of other messages, not even to check those that are asked for."""
        ...

    def release(self) -> None:
        """Give back what can be had again: inflated chunks, open files."""
        ...

    def close(self) -> None: ...
