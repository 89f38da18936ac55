"""Uploads that cannot be corrupted: the core of tus 1.0 without HTTP (design §9).

Read in this order: `declared` (what a client says of a file), `creating` (file, row and quota come to be), `files` (the
bytes, their lock, their marks), `receiving` (one request's bytes), `finishing` (complete, failed, terminated), `rows`
(states; `consume`), `expiring` (the sweeper's part), `hashing`.

**Conventions.** The offset is the number of bytes on disk, nothing else remembers it. Several processes may serve one
folder: the file's lock says who writes, the row's compare-and-set says how it ends.
"""

from services.runtime.uploads.expiring import expire
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import consume

__all__ = ["consume", "expire", "upload_file"]
