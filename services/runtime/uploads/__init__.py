"""Resumable uploads: the core of tus 1.0 without HTTP (design §9).

Read in this order: `creation` (declaration, space, row and quota); `backends`, `files`, `part_writer` and `part_rows`
(the bytes, in a folder or in the store). Then `reception` (one request's bytes), `completion` (complete, failed,
terminated), `rows` (states; `consume`), `expiry` (the sweeper's chores), `joining` (uploads made from parts).

**Conventions.** The offset is the number of bytes received; only the bytes themselves record it. Several processes may
serve one backend: the backend decides who writes, and the row's compare-and-set decides how the upload ends.
"""

from services.runtime.uploads.expiry import expire
from services.runtime.uploads.files import upload_file
from services.runtime.uploads.rows import consume

__all__ = ["consume", "expire", "upload_file"]
