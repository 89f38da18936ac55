"""The interface of message stores, which every container format implements.

**Conventions.** As `stone_recordings.bags.bag`. `release` announces a pause, `close` the end; payloads stay valid after
both.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding

# A topic of a recording: its name, its type and the encoding of its payloads. `type` is written `package/msg/Name`;
# `schema` is the ros2msg text embedded in the recording, "" without one.


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
        """Return the ascending log times of the topic's messages."""
        ...

    def payload(self, topic: str, index: int) -> memoryview:
        """Return the CDR message at `index` in log-time order."""
        ...

    def heads(
        self, topics: Sequence[str], whole: Collection[str] = (), *, is_checked: bool = False
    ) -> Iterator[tuple[str, int, memoryview]]:
        """Yield topic, index and at least the first `HEAD_BYTES` of every message, in storage order.

        A shorter message, and one whose topic is in `whole`, is yielded whole. Damaged messages are skipped if
        `is_checked`, and after the first use of `damaged`.
        """
        ...

    def size_bytes(self, topic: str, index: int) -> int:
        """Return the size of the stored message; cheap for one whose head was just yielded."""
        ...

    def damaged(self, beside: Messages = NO_MESSAGES) -> Mapping[str, Mapping[int, str]]:
        """Return by topic and index the messages that are lost with their damaged container, and the reason.

        Reads everything with a checksum or compression, once; from then on `heads` skips these messages. The containers
        of the messages `beside` are not checked.
        """
        ...

    def read_sparingly(self) -> None:
        """From now on read no bytes of other messages, not even to check the requested ones."""
        ...

    def release(self) -> None:
        """Release data that can be loaded again: inflated chunks, open files."""
        ...

    def close(self) -> None: ...
