"""Bags on one clock as one recording.

**Conventions.** As `stone_recordings.bags.split_store`, but that a topic of two types is told to be of two members.
"""

from collections.abc import Iterable, Sequence

from stone_recordings.bags.errors import IngestError
from stone_recordings.bags.joined.moved_bag import MovedBag
from stone_recordings.bags.split_store import SplitStore


class JoinedTopicError(IngestError):
    """A topic of one name is of two types in the recordings that are to be joined."""

    code = "BAG-041"

    def __init__(self, topic: str, types: Sequence[str]) -> None:
        super().__init__(
            f"topic {topic!r} is {' in one recording and '.join(dict.fromkeys(types))} in another; recordings of one "
            "run name their topics alike: leave one out, or rename the topic when it is recorded"
        )


def check_types(topics: Iterable[tuple[str, str]]) -> None:
    """`topics` of all recordings, by name and type. Raises: JoinedTopicError (BAG-041)."""
    types: dict[str, list[str]] = {}
    for name, type_name in topics:
        types.setdefault(name, []).append(type_name)
    for name, found in types.items():
        if len(set(found)) > 1:
            raise JoinedTopicError(name, found)


def joined_store(name: str, parts: Sequence[MovedBag]) -> SplitStore:
    """Raises: JoinedTopicError (BAG-041)."""
    check_types((topic.name, topic.type) for part in parts for topic in part.topics)
    return SplitStore(name, parts)
