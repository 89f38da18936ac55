"""An object of an allowed bucket, read by ranges into a sparse file.

**Conventions.** Endpoint, bucket and prefix come from the settings; a user gives only the end of the key. Every answer
must have the requested ETag, so that no file mixes two versions of an object.
"""

import ctypes
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from botocore.exceptions import BotoCoreError, ClientError

from services.runtime.in_place.errors import changed_in_place, vanished
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.settings import StoreSettings
from services.runtime.store.s3 import MISSING, client_of, store_unavailable
from stone_recordings.sync.stored_recording import PlacedFile, RecordingPlace

if TYPE_CHECKING:
    from types_boto3_s3 import S3Client

READERS = 8
RANGE_BYTES = 16 * 2**20
TRIES = 4
DENIED = {"403", "AccessDenied", "Forbidden"}
OTHER_VERSION = {"412", "PreconditionFailed"}
PUNCH_HOLE = 0x02 | 0x01  # fallocate(2): and keep the size

Range = tuple[int, int]


class PlacedObject:
    """The object at a place."""

    def __init__(self, settings: InPlaceSettings, place: RecordingPlace) -> None:
        bucket, prefix = settings.bucket_of[place.root]
        self._place, self._bucket, self._key = place, bucket, prefix + place.path
        self._client = _client(settings)
        self.read_bytes = 0

    def file(self) -> PlacedFile:
        """Return the object's current state. Raises `recording_vanished`, `store_unavailable`."""
        with self._translate_errors():
            head = self._client.head_object(Bucket=self._bucket, Key=self._key)
        return PlacedFile(self._place.name, int(head["ContentLength"]), head["ETag"].strip('"'))

    def fetch(self, ranges: Sequence[Range], target: Path) -> None:
        """Write these ranges of the object to the same offsets of the file.

        Raises `recording_changed_in_place`, `recording_vanished`, `store_unavailable`.
        """
        pieces = [(at, min(at + RANGE_BYTES, stop)) for start, stop in ranges for at in range(start, stop, RANGE_BYTES)]
        with target.open("r+b") as file, ThreadPoolExecutor(READERS) as pool:
            for content, (start, _stop) in zip(pool.map(self._read, pieces), pieces, strict=True):
                os.pwrite(file.fileno(), content, start)
                self.read_bytes += len(content)

    def read_at(self, offset: int, count: int) -> bytes:
        """Return these existing bytes of the object. Raises as `fetch`."""
        self.read_bytes += count
        return self._read((offset, offset + count))

    def _read(self, piece: Range) -> bytes:
        start, stop = piece
        for attempt in range(TRIES):
            try:
                with self._translate_errors():
                    answer = self._client.get_object(
                        Bucket=self._bucket,
                        Key=self._key,
                        Range=f"bytes={start}-{stop - 1}",
                        IfMatch=f'"{self._known.version}"',
                    )
                    self._refuse_other(answer["ETag"].strip('"'))
                    content = answer["Body"].read()
            except BotoCoreError as error:
                if attempt + 1 == TRIES:
                    raise store_unavailable(self._bucket, str(error)) from error
                continue
            if len(content) == stop - start:
                return content
        raise store_unavailable(self._bucket, f"it sent bytes other than {start}-{stop} of {self._place}")

    @property
    def _known(self) -> PlacedFile:
        return self._place.files[0]

    def _refuse_other(self, version: str) -> None:
        if version != self._known.version:
            raise changed_in_place(self._place, self.file(), self._known)

    @contextmanager
    def _translate_errors(self) -> Iterator[None]:
        """Translate the client's errors."""
        try:
            yield
        except ClientError as error:
            code = error.response.get("Error", {}).get("Code", "")
            if code in MISSING | DENIED:
                raise vanished(self._place, self._place.name) from error
            if code in OTHER_VERSION:
                raise changed_in_place(self._place, self.file(), self._known) from error
            raise store_unavailable(self._bucket, str(error)) from error


def sparse_file(path: Path, size_bytes: int) -> None:
    """Create a file of this size without allocated blocks."""
    with path.open("wb") as file:
        file.truncate(size_bytes)


def punch(path: Path, ranges: Sequence[Range]) -> None:
    """Free the disk blocks of these ranges, if the file system supports it."""
    libc = ctypes.CDLL(None)
    with path.open("r+b") as file:
        for start, stop in ranges:
            libc.fallocate(file.fileno(), PUNCH_HOLE, ctypes.c_int64(start), ctypes.c_int64(stop - start))


def _client(settings: InPlaceSettings) -> "S3Client":
    return client_of(
        StoreSettings(
            s3_endpoint=settings.s3_endpoint,
            s3_region=settings.s3_region,
            s3_key_id=settings.s3_key_id,
            s3_secret=settings.s3_secret,
        )
    )
