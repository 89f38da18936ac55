"""One pass over the first bytes of all messages: header stamps, and whole copies of the small ones worth looking at.

**Conventions.** Storage order, so each chunk is inflated once. A topic whose messages lie is remembered with its
refusal and left out of the rest of the pass; damage of the container itself is raised.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.ingest.bag import Bag, Topic
from services.ingest.errors import ByteOrderError, MessageLayoutError
from services.ingest.timing import begins_with_header, stamp_of

# A NovAtel solution takes 300 bytes; what is larger is not copied.
KEPT_BYTES = 4096


@dataclass(frozen=True, slots=True)
class KeptMessage:
    payload: memoryview


@dataclass(frozen=True, eq=False)
class Scan:
    """By topic: header stamps (N,) in log order, kept messages in log order, or why the topic was given up."""

    stamps_ns: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    kept: dict[str, list[KeptMessage]] = field(default_factory=dict)
    refused: dict[str, ByteOrderError | MessageLayoutError] = field(default_factory=dict)


def scan_of(bag: Bag, is_kept: Callable[[Topic], bool]) -> Scan:
    """Touches a page per message, never a whole cloud. Raises: the `BAG-*` refusals."""
    stamped = {topic.name: topic for topic in bag.topics if topic.encoding == "cdr" and begins_with_header(topic)}
    stamps_ns = {name: np.zeros(topic.count, np.int64) for name, topic in stamped.items()}
    kept: dict[str, dict[int, bytes]] = {name: {} for name, topic in stamped.items() if is_kept(topic)}
    refused: dict[str, ByteOrderError | MessageLayoutError] = {}
    for name, index, payload in bag.heads(tuple(stamped)):
        if name in refused:
            continue
        try:
            stamps_ns[name][index] = stamp_of(payload, stamped[name].type)
        except (ByteOrderError, MessageLayoutError) as error:
            refused[name] = error
        if name in kept and len(payload) <= KEPT_BYTES:
            kept[name][index] = bytes(payload)
    in_order = {name: [KeptMessage(memoryview(by[index])) for index in sorted(by)] for name, by in kept.items()}
    return Scan({name: stamps for name, stamps in stamps_ns.items() if name not in refused}, in_order, refused)
