"""The topics of a ROS 1 bag under their types in ROS 2, and why one of them is left unread.

**Conventions.** A topic that several publishers wrote is one, if they describe it alike. MSG-307: its definition cannot
be read; BAG-020: it has none, and none is known; BAG-012: its publishers contradict each other.
"""

from collections.abc import Mapping, Sequence
from itertools import islice

from stone.findings import Finding
from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.bags.ros1.definitions import Ros2Type, ros2_type
from stone_recordings.bags.ros1.draft import Ros1Connection, Ros1Type
from stone_recordings.bags.topic import Topic
from stone_recordings.messages.errors import DefinitionRefusedError

# Definitions are parsed; a hostile recording may declare any number of types.
MOST_TYPES = 500
UNREAD = "ros1"


def described(
    connections: Sequence[Ros1Connection], counts: Mapping[str, int]
) -> tuple[tuple[Topic, ...], tuple[Finding, ...]]:
    """Topics by name, `counts` messages each, and a finding for each that is left unread; its encoding is "ros1"."""
    told = dict.fromkeys(connection.type for connection in connections)
    known = {one: _read(one) for one in islice(told, MOST_TYPES)}
    types: dict[str, dict[Ros1Type, None]] = {}
    for connection in connections:
        types.setdefault(connection.topic, {})[connection.type] = None
    topics, findings = [], list[Finding]()
    for name, listed in sorted(types.items()):
        found = _agreed([known.get(one, _TOO_MANY) for one in listed])
        if isinstance(found, Finding):
            findings.append(Finding(found.code, found.severity, name, found.message))
            topics.append(Topic(name, next(iter(listed)).name, counts[name], "", UNREAD))
        else:
            topics.append(Topic(name, found.name, counts[name], found.schema))
    return tuple(topics), tuple(findings)


_TOO_MANY = Finding("MSG-307", "warning", "", f"The recording has more than {MOST_TYPES} types; this one is not read.")


def _read(told: Ros1Type) -> Ros2Type | Finding:
    """The type in ROS 2, or why it is none."""
    try:
        return ros2_type(told)
    except DefinitionMissingError as error:
        message = f"The bag has no definition of {told.name!r}, nor has ROS 1 Noetic: the topic is not read."
        return Finding(error.code, "warning", "", message)
    except DefinitionRefusedError as error:
        return Finding(error.code, "warning", "", str(error))


def _agreed(found: Sequence[Ros2Type | Finding]) -> Ros2Type | Finding:
    first, *others = found
    for other in others:
        if isinstance(first, Ros2Type) and isinstance(other, Ros2Type) and other != first:
            message = f"Its publishers use the types {first.name} and {other.name}, or define them differently."
            return Finding("BAG-012", "warning", "", message)
    return next((one for one in found if isinstance(one, Finding)), first)
