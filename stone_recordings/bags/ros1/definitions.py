"""Message types of ROS 1 as ROS 2 knows them: names, fields, and how the bytes of one become those of the other.

**Conventions.** `package/Name` becomes `package/msg/Name`, `tf/tfMessage` the type that took its place. `seq` of a
header is on the wire of ROS 1 only. A type that is known here with the same wire is that one, so that `K` of a camera
is called `k`; any other stays as the recording describes it. A connection that describes nothing is of ROS 1 Noetic.
Source: wiki.ros.org/msg, common_msgs of ROS 1 and common_interfaces of ROS 2.
"""

from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from typing import NamedTuple

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.bags.ros1.conversion import Conversion
from stone_recordings.bags.ros1.draft import Ros1Type
from stone_recordings.messages.types.definition import CODES, Field, Types, full_name, parsed
from stone_recordings.messages.types.definitions_beside import SECTION
from stone_recordings.messages.types.plan import compiled
from stone_recordings.messages.types.registry import PACKAGES, registry

RENAMED = {"tf/tfMessage": "tf2_msgs/TFMessage"}
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
HEADER, SEQ = "std_msgs/msg/Header", Field("seq", "uint32")
DROPPED = Field("seq of ROS 1", "uint32")  # no name that a definition can have


class Ros2Type(NamedTuple):
    """What that is in ROS 2: package/msg/Name, and its definition as MCAP embeds it."""

    name: str
    schema: str


def ros2_type(told: Ros1Type) -> Ros2Type:
    """Raises: DefinitionRefusedError (no type, or none that is read), DefinitionMissingError (nothing describes it)."""
    name, types = _parsed(told)
    compiled(name, types)
    header = tuple(field for field in types.get(HEADER, ()) if field != SEQ)
    as_ros2 = {**types, HEADER: header}
    return Ros2Type(name, _schema(name, {key: _as_known(key, fields) for key, fields in as_ros2.items()}))


@lru_cache(maxsize=64)
def conversion_of(told: Ros1Type) -> Conversion:
    """Raises: as `ros2_type`."""
    name, types = _parsed(told)
    header = tuple(DROPPED if field == SEQ else field for field in types.get(HEADER, ()))
    return Conversion(compiled(name, {**types, HEADER: header}), DROPPED.name)


def _parsed(told: Ros1Type) -> tuple[str, dict[str, tuple[Field, ...]]]:
    """The name in ROS 2, and the fields on the wire of ROS 1."""
    name = full_name(RENAMED.get(told.name, told.name), told.name)
    types = parsed(told.definition.strip() or _noetic_text(name), name)
    return name, {**{time: registry().types[time] for time in TIMES}, **types}


def _as_known(name: str, fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """With the names that are known here, where the wire is the same."""
    known = registry().types.get(name, ())
    return known if [_wire(field) for field in known] == [_wire(field) for field in fields] else fields


def _wire(field: Field) -> tuple[str, str, int]:
    return CODES.get(field.base, field.base), field.kind, field.length


def _schema(name: str, types: Types) -> str:
    """The type's own fields, then every other type that it uses in a section."""
    others = (f"{SECTION}\nMSG: {_short(other)}\n{_text(types[other])}" for other in _used(name, types))
    return "\n".join([_text(types[name]), *others])


def _used(name: str, types: Types) -> Iterator[str]:
    """The types that a type holds, once each."""
    waiting, seen = [name], {name, *TIMES}
    while waiting:
        found = dict.fromkeys(field.base for field in types[waiting.pop()] if field.base in types)
        fresh = [base for base in found if base not in seen]
        yield from fresh
        seen.update(fresh)
        waiting += fresh


def _text(fields: Sequence[Field]) -> str:
    return "".join(f"{_short(field.base)}{_suffix(field)} {field.name}\n" for field in fields)


def _suffix(field: Field) -> str:
    return {"one": "", "sequence": "[]", "array": f"[{field.length}]"}[field.kind]


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _noetic_text(name: str) -> str:
    """How ROS 1 Noetic describes a type. Raises: DefinitionMissingError."""
    if name not in _noetic().fielddefs:
        raise DefinitionMissingError(name, PACKAGES)
    return _noetic().generate_msgdef(name, ros_version=1)[0]


@cache
def _noetic() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)
