"""Resumable uploads: the core of tus 1.0 without HTTP (design §9).

Read in this order: `declaration` (what a client says of a file), `creation` (room, row and quota come to be), `backend`
(where bytes lie: `folder_backend` with `files`, `store_backend` with `part_reader`, `part_writer` and `part_rows`),
`reception` (one request's bytes), `completion` (complete, failed, terminated), `rows` (states; `consume`), `expiry`
with `sweep_cursor` (the sweeper's share), `running_hash`. How many may wait is in `waiting`.

**Conventions.** The offset is the number of bytes that are here, nothing else remembers it. Several processes may serve
one backend: the backend says who writes, the row's compare-and-set says how it ends.
"""

from services.runtime.uploads.expiry import expire
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import consume

__all__ = ["consume", "expire", "upload_file"]
