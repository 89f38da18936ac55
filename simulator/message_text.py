"""Message definitions as MCAP's ros2msg schemas want them: the type's text, then that of every type it uses.

**Conventions.** Standard types come from rosbags' Humble store, driver types from the `.msg` files of
`services.ingest.messages.definitions`.
"""

from functools import cache
from importlib.resources import files

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

DEFINITIONS = "services.ingest.messages"


def message_definition(kind: str) -> str:
    """The ros2msg text of a type such as "ars548_messages/msg/DetectionList"."""
    return _store().generate_msgdef(kind, ros_version=2)[0]


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for package in (files(DEFINITIONS) / "definitions").iterdir():
        for message in (package / "msg").iterdir():
            store.register(get_types_from_msg(message.read_text(), f"{package.name}/msg/{message.name[:-4]}"))
    return store
