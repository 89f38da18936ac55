"""Settings of recordings that are read in place."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from pydantic import SecretStr

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[^/]+)*/?")


@dataclass(frozen=True)
class InPlaceSettings:
    """Roots of recordings and datasets that are read in place instead of being uploaded; none by default.

    `folders` is a list such as `nas=/mnt/nas/bags, disk=/data/bags`. A curator may register any bag below such a
    folder, for example `nas:2026/run.db3`, or a `.zip` or `.tar` of a published dataset. If some curators must not see
    every file, set a narrower root. The workers of `ingest` and `labeler` need each folder at this path, read-only; the
    API does not.

    `buckets` is a list such as `field=recordings/2026`. A curator may register any `.mcap` object of the bucket
    `recordings` below `2026/`, or a `.zip` of a published dataset. Objects are read by ranges. `s3_endpoint` and the
    keys apply to these buckets only; users cannot set an address. The workers of `ingest` and `labeler` need them; use
    a key with read rights only.
    """

    folders: str = ""
    buckets: str = ""
    s3_endpoint: str = ""
    s3_region: str = "us-east-1"
    s3_key_id: str = ""
    s3_secret: SecretStr = field(default=SecretStr(""))

    @property
    def folder_of(self) -> Mapping[str, str]:
        """The folder of each folder root."""
        return dict(_named(self.folders))

    @property
    def bucket_of(self) -> Mapping[str, tuple[str, str]]:
        """The bucket and key prefix of each bucket root."""
        return {name: _bucket(value) for name, value in _named(self.buckets)}

    @property
    def roots(self) -> list[str]:
        """The names of all roots."""
        return sorted({*self.folder_of, *self.bucket_of})


def in_place_contradictions(settings: InPlaceSettings) -> Iterator[str]:
    """Yield a sentence for each entry that defines no root."""
    folders, buckets = list(_named(settings.folders)), list(_named(settings.buckets))
    for name, folder in folders:
        if not NAME.fullmatch(name) or not folder.startswith("/"):
            yield f"STONE_IN_PLACE__FOLDERS has {name[:80]!r} as {folder[:80]!r}; an entry is name=/folder{_NAMES}"
    for name, bucket in buckets:
        if not NAME.fullmatch(name) or not BUCKET.fullmatch(bucket):
            yield f"STONE_IN_PLACE__BUCKETS has {name[:80]!r} as {bucket[:80]!r}; an entry is name=bucket/key{_NAMES}"
    names = [name for name, _ in (*folders, *buckets)]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"STONE_IN_PLACE__FOLDERS and STONE_IN_PLACE__BUCKETS contain the root {name[:80]!r} twice"


_NAMES = ", and a name consists of small letters, digits, _ and -"


def _named(entries: str) -> Iterator[tuple[str, str]]:
    for entry in filter(None, map(str.strip, entries.split(","))):
        name, _, value = entry.partition("=")
        yield name.strip(), value.strip()


def _bucket(value: str) -> tuple[str, str]:
    bucket, _, prefix = value.partition("/")
    prefix = prefix.strip("/")
    return bucket, f"{prefix}/" if prefix else ""
