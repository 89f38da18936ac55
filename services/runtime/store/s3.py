"""A store in an S3 bucket, with a cache of whole objects on this machine.

**Conventions.** The store relies on no feature in which S3-compatible servers differ: If-None-Match, ETags as MD5,
refusal of a wrong checksum (the database has our own sha256). Checksums are sent and requested only if the protocol
requires them: some servers reply to a ranged read with the checksum of the whole. A file enters the cache whole or not
at all.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import boto3
from boto3.exceptions import Boto3Error
from boto3.s3.transfer import TransferConfig
from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError

from services.runtime.settings import Settings, StoreSettings
from services.runtime.store.cache import Cache
from services.runtime.store.folder import refusing_full
from services.runtime.store.free_space import require_room
from services.runtime.store.keys import ObjectMissingError, StoreFullError, checked, checked_prefix, checked_range
from services.runtime.store.protocol import StoredObject
from services.runtime.telemetry.counters import STORE_BYTES, process_counters
from services.runtime.telemetry.tracing import span
from stone.errors import PlatformFaultError

if TYPE_CHECKING:
    from types_boto3_s3 import S3Client
    from types_boto3_s3.type_defs import GetObjectOutputTypeDef


MIB = 2**20
PIECE_BYTES = MIB
RESUMES = 4
MISSING = {"404", "NoSuchKey", "NotFound"}
NO_SPACE = {"QuotaExceeded", "InsufficientStorage", "XMinioStorageFull", "507"}
PART_BYTES = 16 * MIB
TRANSFERS = 4
TRANSFER = TransferConfig(multipart_threshold=PART_BYTES, multipart_chunksize=PART_BYTES, max_concurrency=TRANSFERS)
CLIENT = Config(
    connect_timeout=5,
    read_timeout=60,
    retries={"mode": "standard", "total_max_attempts": 5},
    max_pool_connections=32,
    request_checksum_calculation="when_required",
    response_checksum_validation="when_required",
)


class S3Store:
    """Objects of the bucket in `settings`; raises `store_unavailable` if it does not respond."""

    def __init__(self, settings: Settings) -> None:
        self.bucket = settings.store.s3_bucket
        self._client = client_of(settings.store)
        self.cache = Cache(settings.root / "cache", settings.store.cache_bytes)
        self._reserve_bytes = settings.store.reserve_bytes

    def write(self, key: str, source: Path) -> None:
        """Upload `source`, in parts if it is large. Raises `StoreFullError`."""
        size_bytes = source.stat().st_size
        with self._translating(checked(key)), span("store write", attributes={"stone.size_bytes": size_bytes}):
            self._client.upload_file(str(source), self.bucket, key, Config=TRANSFER)
        self.forget_copy(key)
        process_counters().add(STORE_BYTES, ("in",), size_bytes)

    def adopt(self, key: str, source: Path) -> None:
        """Upload `source`; it stays."""
        self.write(key, source)

    def read(self, key: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Yield the bytes [start, stop), clipped to the object, in pieces; a missing object raises at the call."""
        checked_range(start, stop)
        end = self.size_bytes(key)
        return self._pieces(key, start, end if stop is None else min(stop, end))

    def size_bytes(self, key: str) -> int:
        with self._translating(checked(key)):
            length = self._client.head_object(Bucket=self.bucket, Key=key).get("ContentLength")
        if length is None:  # the reply broke off within its header, which no layer below detects
            raise store_unavailable(self._place, f"it sent no length for {key}")
        return int(length)

    def local(self, key: str) -> Path:
        """Return the cached copy, downloaded if missing; it is not evicted within an hour of the last call."""
        return self.cache.file(checked(key), self.download)

    def download(self, key: str, target: Path) -> None:
        """Write the object into the file `target` and flush it. Raises `StoreFullError` if the disk is full.

        Ranges are read in parallel and resumed after interruptions (boto3's own download hung on a broken header).
        """
        starts = range(0, self.size_bytes(key), PART_BYTES)
        require_room(target.parent, starts.stop, self._reserve_bytes)
        with (
            span("store download", attributes={"stone.size_bytes": starts.stop}),
            refusing_full(target.parent),
            target.open("wb") as file,
            ThreadPoolExecutor(TRANSFERS) as pool,
        ):
            list(pool.map(lambda start: self._fetch(key, file.fileno(), start), starts))
            os.fsync(file.fileno())

    def _fetch(self, key: str, descriptor: int, start: int) -> None:
        for piece in self.read(key, start, start + PART_BYTES):
            start += os.pwrite(descriptor, piece, start)

    def forget_copy(self, key: str) -> None:
        self.cache.forget(checked(key))

    def delete(self, key: str) -> None:
        with self._translating(checked(key)):
            self._client.delete_object(Bucket=self.bucket, Key=key)

    def listed(self, prefix: str) -> Iterator[StoredObject]:
        pages = self._client.get_paginator("list_objects_v2").paginate(
            Bucket=self.bucket, Prefix=checked_prefix(prefix)
        )
        with self._translating(prefix):
            for page in pages:
                for entry in page.get("Contents", []):
                    modified_ns = int(entry["LastModified"].timestamp() * 1e9)
                    yield StoredObject(entry["Key"], entry["Size"], modified_ns)

    def tidy(self, grace_s: float) -> int:
        """Abort multipart uploads started before the grace, and delete leftovers of dead downloads from the cache."""
        before = datetime.now(UTC) - timedelta(seconds=grace_s)
        aborted = 0
        with self._translating(""), suppress(self._client.exceptions.NoSuchUpload):
            for page in self._client.get_paginator("list_multipart_uploads").paginate(Bucket=self.bucket):
                for upload in page.get("Uploads", []):
                    aborted += upload["Initiated"] <= before and self._aborted(upload["Key"], upload["UploadId"])
        return aborted + self.cache.tidy()

    def _aborted(self, key: str, upload_id: str) -> bool:
        self._client.abort_multipart_upload(Bucket=self.bucket, Key=key, UploadId=upload_id)
        return True

    def _pieces(self, key: str, start: int, stop: int) -> Iterator[bytes]:
        """Yield the bytes, resuming after interruptions, at most `RESUMES` times without a new piece."""
        failures, reason = 0, "it ended early"
        while start < stop:
            before = start
            try:
                for piece in self._opened(key, start, stop)["Body"].iter_chunks(PIECE_BYTES):
                    start += len(piece)
                    process_counters().add(STORE_BYTES, ("out",), len(piece))
                    yield piece
            except BotoCoreError as error:
                reason = str(error)
            failures = 0 if start - before >= PIECE_BYTES else failures + 1
            if failures > RESUMES:
                raise store_unavailable(self._place, reason)

    def _opened(self, key: str, start: int, stop: int) -> "GetObjectOutputTypeDef":
        with self._translating(key):
            return self._client.get_object(Bucket=self.bucket, Key=key, Range=f"bytes={start}-{stop - 1}")

    @property
    def _place(self) -> str:
        return f"{self._client.meta.endpoint_url}/{self.bucket}"

    @contextmanager
    def _translating(self, key: str) -> Iterator[None]:
        """Raise the store's errors instead of the client's."""
        try:
            yield
        except ClientError as error:
            code = error.response.get("Error", {}).get("Code", "")
            if code in MISSING:
                raise ObjectMissingError(key) from error
            if code in NO_SPACE:
                raise StoreFullError(self._place) from error
            raise store_unavailable(self._place, str(error)) from error
        except (BotoCoreError, Boto3Error) as error:
            raise store_unavailable(self._place, str(error)) from error


def client_of(store: StoreSettings) -> "S3Client":
    """Return a client; empty keys are looked up by AWS's own rules."""
    return boto3.client(
        "s3",
        endpoint_url=store.s3_endpoint or None,
        region_name=store.s3_region,
        aws_access_key_id=store.s3_key_id or None,
        aws_secret_access_key=store.s3_secret.get_secret_value() or None,
        config=CLIENT,
    )


# Create the S3 bucket at the first start, if the store's key has the permission.


FORBIDDEN = {"403", "AccessDenied", "Forbidden"}
UNCONSTRAINED = "us-east-1"
"""The one region that must not be named when a bucket is created."""
ABSENT = {"404", "NoSuchBucket", "NotFound"}
EXISTING = {"BucketAlreadyOwnedByYou", "BucketAlreadyExists"}


def ensure_bucket(store: StoreSettings) -> bool:
    """Create the bucket unless it exists or may not be listed; return whether it was created.

    Raises `store_unavailable`.
    """
    client, bucket = client_of(store), store.s3_bucket
    try:
        return not _exists(client, bucket) and _create(client, store)
    except (BotoCoreError, ClientError) as error:
        raise store_unavailable(f"{client.meta.endpoint_url}/{bucket}", str(error)) from error


def _exists(client: "S3Client", bucket: str) -> bool:
    try:
        client.head_bucket(Bucket=bucket)
    except ClientError as error:
        if _code(error) in ABSENT:
            return False
        if _code(error) not in FORBIDDEN:
            raise
    return True


def _create(client: "S3Client", store: StoreSettings) -> bool:
    constraint: dict[str, Any] = {"LocationConstraint": store.s3_region}
    arguments: dict[str, Any] = {} if store.s3_region == UNCONSTRAINED else {"CreateBucketConfiguration": constraint}
    try:
        client.create_bucket(Bucket=store.s3_bucket, **arguments)
    except ClientError as error:
        if _code(error) in EXISTING:
            return False
        raise
    return True


def _code(error: ClientError) -> str:
    return str(error.response.get("Error", {}).get("Code", ""))


def store_unavailable(place: str, reason: str) -> PlatformFaultError:
    return PlatformFaultError("store_unavailable", f"the store at {place} failed: {reason}; try again when it responds")
