"""Roots for files in place: a folder, or a prefix of a bucket of the S3 server that tests start."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.s3 import client_of
from testing.servers.s3 import S3Server

PREFIX = "2026"


def in_folder(platform: Platform, root: Path) -> Platform:
    """Return the platform with the root `nas`."""
    settings = platform.settings.model_copy(update={"in_place": InPlaceSettings(f"nas={root}")})
    return replace(platform, settings=settings)


def on_bucket(platform: Platform, server: S3Server) -> Platform:
    """Return the platform with the root `field`, a prefix of a fresh bucket; its own store is a folder."""
    store = server.settings()
    in_place = InPlaceSettings(
        buckets=f"field={store.s3_bucket}/{PREFIX}",
        s3_endpoint=store.s3_endpoint,
        s3_key_id=store.s3_key_id,
        s3_secret=store.s3_secret,
    )
    return replace(platform, settings=platform.settings.model_copy(update={"in_place": in_place}))


def bucket_of(platform: Platform) -> str:
    """Return the bucket of the root `field`."""
    return platform.settings.in_place.bucket_of["field"][0]


def bucket_client(platform: Platform) -> Any:
    """Return a client of the bucket's server."""
    settings = platform.settings.in_place
    return client_of(
        StoreSettings(s3_endpoint=settings.s3_endpoint, s3_key_id=settings.s3_key_id, s3_secret=settings.s3_secret)
    )


def put(platform: Platform, path: Path, key: str) -> None:
    """Write the object of this key."""
    bucket_client(platform).put_object(Bucket=bucket_of(platform), Key=key, Body=path.read_bytes())


def stored_bytes(platform: Platform) -> int:
    """Return the size in bytes of all objects of a platform with a folder store."""
    files = (path for path in (platform.settings.root / "store").rglob("*") if path.is_file())
    return sum(path.stat().st_size for path in files)
