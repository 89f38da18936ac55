"""The check that the message types of a recording have a known definition.

**Conventions.** BAG-020: a `.db3` of Humble embeds no definitions, so a type without one in the registry cannot be
read; the topic passes through untouched. MSG-309: an embedded definition that differs from the known one, over which it
takes precedence.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from stone.errors import StoneError
from stone.findings import Finding
from stone_recordings.bags.bag import Topic
from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.messages.types.registry import PACKAGES, resolved

# Definitions are parsed; a hostile recording may declare any number of types.
MOST_DEFINITIONS = 500


def definition_findings(topics: Sequence[Topic]) -> Iterator[Finding]:
    """Yield a finding per topic with messages whose definition is missing, unreadable, or different from the known
    one.
    """
    described = [topic for topic in topics if topic.count and topic.encoding == "cdr"]
    for topic in described[:MOST_DEFINITIONS]:
        yield from _of_topic(topic)
    if len(described) > MOST_DEFINITIONS:
        left = len(described) - MOST_DEFINITIONS
        yield Finding("BAG-020", "info", "", f"The definitions of {left} further topics were not checked.")


def _of_topic(topic: Topic) -> Iterator[Finding]:
    try:
        yield from (replace(finding, topic=topic.name) for finding in resolved(topic.type, topic.schema).findings)
    except DefinitionMissingError as error:
        known = f"known beside ROS 2 Humble's: {', '.join(PACKAGES)}"
        message = (
            f"The recording has no definition for {topic.type!r}, nor has the registry ({known}). "
            "Upload its .msg files, or record with -s mcap; until then the topic is not decoded."
        )
        yield Finding(error.code, "warning", topic.name, message)
    except StoneError as error:
        yield Finding(error.code, "warning", topic.name, str(error))
