"""A bounded reader of rosbag2's metadata.yaml, for the files it lists.

**Conventions.** Counts, times and types in it are never used, the files say them. The events of the YAML are walked
and nothing is built from them, so that aliases and depth cost what their bytes cost.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, MappingStartEvent, NodeEvent, ScalarEvent

ROOT = "rosbag2_bagfile_information"
SIZE_LIMIT_BYTES = 4 * 2**20
EVENT_LIMIT = 200_000
DEPTH_LIMIT = 24


class MetadataError(Exception):
    """The file cannot be understood; the sentence says why. The folder is read without it."""


@dataclass(frozen=True)
class BagMetadata:
    """`files` as listed, in order."""

    files: tuple[str, ...]


def read_metadata(path: Path) -> BagMetadata:
    """Raises: MetadataError."""
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_LIMIT_BYTES + 1)
        if len(content) > SIZE_LIMIT_BYTES:
            raise MetadataError(f"metadata.yaml is larger than {SIZE_LIMIT_BYTES} bytes")
        values = list(_values(content.decode()))
    except (OSError, ValueError, YAMLError) as error:
        said = " ".join(str(error).split())[:160]
        raise MetadataError(f"metadata.yaml cannot be read ({said})") from None
    files = tuple(value for place, value in values if place == (ROOT, "relative_file_paths", ""))
    if not files:
        raise MetadataError("metadata.yaml lists no files")
    return BagMetadata(files)


@dataclass
class _YamlLevel:
    """Where the walk is inside one mapping or sequence; `key` is None before a mapping's next key."""

    is_mapping: bool
    key: str | None = None


def _values(text: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Every scalar with the keys that lead to it; an item of a sequence has the key ""."""
    levels: list[_YamlLevel] = []
    for number, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
        if number > EVENT_LIMIT or len(levels) > DEPTH_LIMIT:
            raise MetadataError(f"metadata.yaml has more than {EVENT_LIMIT} values or {DEPTH_LIMIT} levels")
        if isinstance(event, CollectionEndEvent):
            levels.pop()
            _next_key(levels)
        elif isinstance(event, NodeEvent):
            yield from _value(levels, event)


def _value(levels: list[_YamlLevel], event: NodeEvent) -> Iterator[tuple[tuple[str, ...], str]]:
    is_key = bool(levels) and levels[-1].is_mapping and levels[-1].key is None
    if is_key:
        levels[-1].key = event.value if isinstance(event, ScalarEvent) else "?"
    elif isinstance(event, ScalarEvent):
        yield tuple(level.key or "" for level in levels), event.value
    if isinstance(event, CollectionStartEvent):
        levels.append(_YamlLevel(isinstance(event, MappingStartEvent)))
    elif not is_key:
        _next_key(levels)


def _next_key(levels: list[_YamlLevel]) -> None:
    if levels:
        levels[-1].key = None
