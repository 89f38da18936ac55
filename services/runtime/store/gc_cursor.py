"""The cursor of garbage collection, which looks at a slice of the blobs each time, and walks through long listings.

**Conventions.** Other chores wait for the end of a turn, so none may last long. Blobs are looked at in the order of
their contents, objects by the first byte of that; where a turn ended is forgotten with the process.
"""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Generic, TypeVar

from services.runtime.store.protocol import StoredObject

SHARE_S = 5.0
DELETING_S = 20.0
SLICE = 20_000
SHARDS = 256
LISTED = 5000
WORKSPACES = 200

T = TypeVar("T")


@dataclass
class ListingWalk(Generic[T]):
    """A walk through what is listed one by one, over several turns."""

    _left: Iterator[T] | None = None

    def turn(self, listed: Iterable[T], most: int) -> list[T]:
        """At most so many. `listed` is begun where the last turn came to the end, or could not go on."""
        left = iter(listed) if self._left is None else self._left
        self._left = None
        found = list(islice(left, most))
        if len(found) == most:
            self._left = left
        return found


@dataclass
class GcCursor:
    """The blobs after `after_sha256` are next, `slice_rows` at a time until `share_s` have passed, at least once.

    What is condemned is deleted until `deleting_s` have passed; of objects under way `listed` are looked at.
    """

    share_s: float = SHARE_S
    slice_rows: int = SLICE
    after_sha256: str = ""
    shard: int = 0
    deleting_s: float = DELETING_S
    listed: int = LISTED
    workspaces: int = WORKSPACES
    of_uploads: ListingWalk[StoredObject] = field(default_factory=ListingWalk)
    of_work: ListingWalk[tuple[str, list[int]]] = field(default_factory=ListingWalk)

    def until_s(self) -> float:
        """When this time's share will be used up, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def next_shard(self, prefix: str) -> str:
        """The keys below `prefix` whose content begins with one byte, another one each time."""
        shard, self.shard = self.shard, (self.shard + 1) % SHARDS
        return f"{prefix}{shard:02x}/"


def whole_cursor() -> GcCursor:
    """One whose turn looks at everything."""
    forever_s, all_there_is = float("inf"), 2**63 - 1
    return GcCursor(forever_s, deleting_s=forever_s, listed=all_there_is, workspaces=all_there_is)
