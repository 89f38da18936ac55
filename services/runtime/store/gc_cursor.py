"""The cursor of garbage collection, which looks at a slice of the blobs each time.

**Conventions.** The sweeper that collects also takes up what died, so no step may last long. Blobs are looked at
in the order of their contents, objects by the first byte of that; where a turn ended is forgotten with the process.
"""

import time
from dataclasses import dataclass

SHARE_S = 5.0
SLICE = 20_000
SHARDS = 256


@dataclass
class GcCursor:
    """The blobs after `after_sha256` are next, `slice_rows` at a time until `share_s` have passed, at least once."""

    share_s: float = SHARE_S
    slice_rows: int = SLICE
    after_sha256: str = ""
    shard: int = 0

    def until_s(self) -> float:
        """When this time's share will be used up, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def next_shard(self, prefix: str) -> str:
        """The keys below `prefix` whose content begins with one byte, another one each time."""
        shard, self.shard = self.shard, (self.shard + 1) % SHARDS
        return f"{prefix}{shard:02x}/"
