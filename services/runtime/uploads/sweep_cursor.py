"""The cursor of the uploads' sweep, which looks at some of very many uploads each time.

**Conventions.** How many uploads wait, and how many files lie about, is up to whoever uploads; how long a turn takes
is not. Each walk goes on where its last turn ended, and from the beginning once it came to the end. What could not be
dealt with is passed by and looked at again in the next round. Where a turn ended is forgotten with the process.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from sqlalchemy import select, tuple_

from services.runtime.database.transactions import Database
from services.runtime.orm import Upload
from services.runtime.store.gc_cursor import ListingWalk
from services.runtime.uploads.rows import is_waiting

SLICE = 1000
FILES = 2000
SHARE_S = 5.0
NEVER_NS = 2**63 - 1


@dataclass
class ExpiryWalk:
    """A walk through the uploads that wait, in the order in which they expire."""

    _after: tuple[int, str] = (0, "")

    def turn(self, database: Database, most: int, first_ns: int = 0, last_ns: int = NEVER_NS) -> Iterator[Upload]:
        """At most so many of those that expire within [first, last]; one that is not asked for comes next time."""
        place = tuple_(Upload.expires_ns, Upload.id)
        ordered = select(Upload).where(is_waiting(), place > max(self._after, (first_ns, "")))
        ordered = ordered.where(Upload.expires_ns <= last_ns).order_by(Upload.expires_ns, Upload.id)
        with database.reading() as session:
            found = list(session.scalars(ordered.limit(most)))
        for upload in found:
            self._after = (upload.expires_ns, upload.id)
            yield upload
        if len(found) < most:
            self._after = (0, "")


@dataclass
class UploadCursor:
    """Where each walk goes on: `slice_rows` uploads and `slice_files` files of a backend a turn, at most.

    Files that are whole are read again for `share_s` a turn, and one of them at least.
    """

    slice_rows: int = SLICE
    slice_files: int = FILES
    share_s: float = SHARE_S
    overdue: ExpiryWalk = field(default_factory=ExpiryWalk)
    unsettled: ExpiryWalk = field(default_factory=ExpiryWalk)
    _names: dict[type, ListingWalk[str]] = field(default_factory=dict)

    def until_s(self) -> float:
        """When this turn's share will be used up, on the monotonic clock."""
        return time.monotonic() + self.share_s

    def names_in(self, backend: type) -> ListingWalk[str]:
        """The walk through the files of a kind of backend."""
        return self._names.setdefault(backend, ListingWalk())
