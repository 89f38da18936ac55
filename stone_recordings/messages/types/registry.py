"""Definitions of message types: built in, uploaded, or embedded in the recording.

**Conventions.** `ros2msg`: the type's own fields, then for every type in use a line of 80 "=", "MSG: package/Name" and
that type's fields. Standard types are ROS 2 Humble's, from rosbags; the types under `definitions/` are ours, written
from field lists (`definitions/README.md` lists sources and licences). An embedded definition takes precedence over a
known one, because it describes the recorded bytes; a finding reports a difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stone.findings import Finding
from stone_recordings.bags.errors import DefinitionMissingError
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.definition import MOST_CHARACTERS, Field, Types, full_name, parsed
from stone_recordings.messages.types.plan import Node, compiled

PACKAGES = (
    "ars548_messages", "continental_msgs", "gps_common", "gps_msgs", "hesai_ros_driver", "livox_interfaces",
    "livox_ros_driver", "livox_ros_driver2", "nebula_msgs", "novatel_oem7_msgs", "pandar_msgs",
    "point_cloud_interfaces", "radar_msgs", "velodyne_msgs",
)  # fmt: skip
MOST_UPLOADS = 512
MOST_UPLOADED_CHARACTERS = 4 * MOST_CHARACTERS


class MessageText(NamedTuple):
    """A definition and the type that it defines."""

    type_name: str
    text: str


@dataclass(frozen=True, eq=False)
class Registry:
    """The known message types; `types` maps full names to fields. Plans are compiled once and kept with it."""

    types: Types
    _plans: dict[str, tuple[Node, ...]] = field(default_factory=dict, repr=False)

    def __contains__(self, type_name: object) -> bool:
        return type_name in self.types

    def plan(self, type_name: str) -> tuple[Node, ...]:
        """Return the plan of a type. Raises: DefinitionMissingError, DefinitionRefusedError."""
        if type_name not in self.types:
            raise DefinitionMissingError(type_name, PACKAGES)
        if type_name not in self._plans:
            self._plans[type_name] = compiled(type_name, self.types)
        return self._plans[type_name]

    def with_types(self, types: Types) -> "Registry":
        """Return a registry with these types before the known ones."""
        return Registry({**self.types, **types})


class ResolvedRegistry(NamedTuple):
    """The registry to decode one topic with, and the finding about its definition."""

    registry: Registry
    findings: tuple[Finding, ...]


def registry(extra: Sequence[Path | MessageText] = ()) -> Registry:
    """Return the registry of built-in and `extra` definitions, which take precedence: files …/package/msg/Name.msg, or
    texts.

    Raises: DefinitionRefusedError.
    """
    if not extra:
        return _built_in()
    if len(extra) > MOST_UPLOADS:
        raise DefinitionRefusedError(f"{len(extra)} files", f"at most {MOST_UPLOADS} are read")
    types: dict[str, tuple[Field, ...]] = {}
    characters = 0
    for source in extra:
        named = source if isinstance(source, MessageText) else _of_file(source)
        characters += len(named.text)
        if characters > MOST_UPLOADED_CHARACTERS:
            problem = f"the files have more than {MOST_UPLOADED_CHARACTERS} characters together"
            raise DefinitionRefusedError(named.type_name, problem)
        types |= parsed(named.text, named.type_name)
    known = _built_in().with_types(types)
    for type_name in types:
        known.plan(type_name)
    return known


@lru_cache(maxsize=64)
def resolved(type_name: str, schema: str, known: Registry | None = None) -> ResolvedRegistry:
    """Return how to decode a topic of `type_name` that embeds `schema` ("" for none).

    If an embedded definition cannot be read (ros2idl), the known one is used. Raises DefinitionRefusedError only if
    none is known either, DefinitionMissingError without any definition.
    """
    base = known or registry()
    if not schema.strip():
        base.plan(type_name)
        return ResolvedRegistry(base, ())
    try:
        types = parsed(schema, type_name)
        embedded = base.with_types(types)
        embedded.plan(type_name)
    except DefinitionRefusedError as error:
        if type_name not in base:
            raise
        message = f"the embedded definition of {type_name} is not read, the one known here is used: {error}"
        return ResolvedRegistry(base, (Finding("MSG-310", "warning", "", message),))
    difference = _difference(base.types, types)
    if not difference:
        return ResolvedRegistry(embedded, ())
    message = f"the embedded definition of {type_name} differs from the one known here ({difference}); it is used"
    return ResolvedRegistry(embedded, (Finding("MSG-309", "warning", "", message),))


@cache
def message_definition(type_name: str) -> str:
    """Return the ros2msg text of a built-in type such as "sensor_msgs/msg/Imu". Raises: DefinitionMissingError."""
    if type_name not in registry():
        raise DefinitionMissingError(type_name, PACKAGES)
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


@cache
def typestore() -> Typestore:
    """Return rosbags' Humble types and ours, for code that writes messages: serialises, deserialises and describes
    them.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Typesdict = {}
    for named in _own_texts():
        types |= get_types_from_msg(named.text, named.type_name)
    store.register(types)
    return store


def _difference(known: Mapping[str, tuple[Field, ...]], types: Mapping[str, tuple[Field, ...]]) -> str:
    """Return the first field, in the first type, that differs; "" without a difference."""
    for name, fields in types.items():
        if name not in known or known[name] == fields:
            continue
        ours = known[name]
        index = next((i for i, pair in enumerate(zip(ours, fields, strict=False)) if pair[0] != pair[1]), None)
        if index is None:
            return f"{name} has {len(fields)} fields, {len(ours)} are known"
        return f"{name} has {_line(fields[index])!r} where {_line(ours[index])!r} is known"
    return ""


def _of_file(path: Path) -> MessageText:
    if path.suffix != ".msg":
        raise DefinitionRefusedError(path.name, "it is not a .msg file")
    if path.stat().st_size > MOST_CHARACTERS:
        raise DefinitionRefusedError(path.name, f"the file is larger than {MOST_CHARACTERS} bytes")
    package = path.parent.parent.name if path.parent.name == "msg" else path.parent.name
    try:
        return MessageText(full_name(f"{package}/{path.stem}", path.name), path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise DefinitionRefusedError(path.name, "it is not UTF-8 text") from None


@cache
def _built_in() -> Registry:
    described = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    types = {name: tuple(_described(*field) for field in fields) for name, (_constants, fields) in described.items()}
    for named in _own_texts():
        types |= parsed(named.text, named.type_name)
    return Registry(types)


@cache
def _own_texts() -> tuple[MessageText, ...]:
    root = files("stone_recordings.messages.types") / "definitions"
    return tuple(
        MessageText(f"{package}/msg/{file.name.removesuffix('.msg')}", file.read_text(encoding="utf-8"))
        for package in PACKAGES
        for file in (root / package / "msg").iterdir()
        if file.name.endswith(".msg")
    )


def _described(name: str, described: FieldDesc) -> Field:
    """Return a field from rosbags' description."""
    if described[0] == Nodetype.BASE:
        return Field(name, described[1][0])
    if described[0] == Nodetype.NAME:
        return Field(name, described[1])
    element, length = described[1]
    base = element[1][0] if element[0] == Nodetype.BASE else element[1]
    return Field(name, base, "array", length) if described[0] == Nodetype.ARRAY else Field(name, base, "sequence")


def _line(field: Field) -> str:
    suffix = {"one": "", "sequence": "[]", "array": f"[{field.length}]"}[field.kind]
    return f"{_short(field.base)}{suffix} {field.name}"


def _short(name: str) -> str:
    return name.replace("/msg/", "/")
