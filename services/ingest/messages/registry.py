"""Definitions of the message types that recordings of this rig hold, as the text that MCAP embeds.

**Conventions.** `ros2msg`: the type's own fields, then for every type it uses a line of 80 "=", "MSG: package/Name" and
that type's fields. Standard types are ROS 2 Humble's, from rosbags; the files under `definitions/` are ours, written
from field lists: novatel_oem7_msgs of the driver's humble branch (its default branch has another `Oem7Header` and
decodes to nonsense), ars548_messages of ars548_ros.
"""

from functools import cache
from importlib.resources import files

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from services.ingest.errors import DefinitionMissingError

PACKAGES = ("ars548_messages", "novatel_oem7_msgs")


@cache
def typestore() -> Typestore:
    """rosbags' Humble types and ours: serialises, deserialises and describes them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Typesdict = {}
    for text, name in _own():
        types |= get_types_from_msg(text, name)
    store.register(types)
    return store


@cache
def message_definition(type_name: str) -> str:
    """ros2msg text of a type such as "sensor_msgs/msg/Imu". Raises: DefinitionMissingError."""
    store = typestore()
    if type_name not in store.fielddefs:
        raise DefinitionMissingError(type_name, PACKAGES)
    return store.generate_msgdef(type_name, ros_version=2)[0]


def _own() -> list[tuple[str, str]]:
    root = files("services.ingest.messages") / "definitions"
    return [
        (file.read_text(encoding="utf-8"), f"{package}/msg/{file.name.removesuffix('.msg')}")
        for package in PACKAGES
        for file in (root / package / "msg").iterdir()
        if file.name.endswith(".msg")
    ]
