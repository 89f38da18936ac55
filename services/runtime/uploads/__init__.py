"""Uploads that cannot be corrupted: the core of tus 1.0 without HTTP (design §9).

Read in this order: `declared` (what a client says of a file), `creating` (room, row and quota come to be), `place`
(where bytes lie: `folder_place` with `files`, `store_place` with `held_slabs` and `slab_rows`), `receiving` (one
request's bytes), `finishing` (complete, failed, terminated), `rows` (states; `consume`), `expiring` (the sweeper's
part), `hashing`.

**Conventions.** The offset is the number of bytes that are here, nothing else remembers it. Several processes may serve
one place: the place says who writes, the row's compare-and-set says how it ends.
"""

from services.runtime.uploads.expiring import expire
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import consume

__all__ = ["consume", "expire", "upload_file"]
