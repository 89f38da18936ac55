"""Settings of recordings that are read where they lie."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")


@dataclass(frozen=True)
class InPlaceSettings:
    """Roots of recordings that are read where they lie instead of being uploaded; none by default.

    `folders` is a list as `nas=/mnt/nas/bags, disk=/data/bags`: a curator may name any bag below such a folder, for
    instance `nas:2026/run.db3`. If not every curator may label every bag, set a narrower root. The workers of `ingest`
    and `labeler` need each folder at this path, read-only; the API does not.
    """

    folders: str = ""

    @property
    def folder_of(self) -> Mapping[str, str]:
        """The folder of each root."""
        return dict(_named(self.folders))

    @property
    def roots(self) -> list[str]:
        """The names of all roots."""
        return sorted(self.folder_of)


def in_place_contradictions(settings: InPlaceSettings) -> Iterator[str]:
    """Entries that name no root."""
    for name, folder in _named(settings.folders):
        if not NAME.fullmatch(name) or not folder.startswith("/"):
            yield (
                f"STONE_IN_PLACE__FOLDERS names {name[:80]!r} as {folder[:80]!r}; an entry is name=/folder, and a name "
                "has small letters, digits, _ and -"
            )


def _named(entries: str) -> Iterator[tuple[str, str]]:
    for entry in filter(None, map(str.strip, entries.split(","))):
        name, _, value = entry.partition("=")
        yield name.strip(), value.strip()
