"""Definitions of messages beside a recording, for the topics whose recorder embedded none.

**Conventions.** Files `package.Name.msg` in the recording's own folder, flat as uploads are: `my_msgs.Reading.msg`
defines `my_msgs/msg/Reading`. They may use each other; other types are looked up as usual. An embedded definition takes
precedence. Source: rosbag2 of ROS 2 Humble, whose databases hold no definitions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from stone.findings import Finding
from stone_files.bag_fingerprint import DEFINITION
from stone_recordings.bags.message_store import Topic
from stone_recordings.messages.errors import DefinitionRefusedError
from stone_recordings.messages.types.registry import MessageText, registry

LARGEST_BYTES = 65_536
SECTION = "=" * 80


def described(topics: Sequence[Topic], folder: Path) -> tuple[tuple[Topic, ...], tuple[Finding, ...]]:
    """Return the topics, with a definition from `folder` for those without one, and findings about the files."""
    try:
        texts = {text.type_name: text.text for text in _texts(folder)}
        registry(tuple(MessageText(name, text) for name, text in texts.items()))
    except DefinitionRefusedError as error:
        return tuple(topics), (Finding(error.code, "warning", "", f"{error}; no definition beside the bag is used"),)
    return tuple(
        topic if topic.schema or topic.type not in texts else replace(topic, schema=_schema(topic.type, texts))
        for topic in topics
    ), ()


def _texts(folder: Path) -> Iterator[MessageText]:
    """Yield the files' texts. Raises: DefinitionRefusedError."""
    files = sorted(file for file in folder.glob("*.msg") if DEFINITION.fullmatch(file.name) and file.is_file())
    for file in files:
        package, name = file.name.removesuffix(".msg").split(".")
        with file.open("rb") as stream:
            content = stream.read(LARGEST_BYTES + 1)
        if len(content) > LARGEST_BYTES:
            raise DefinitionRefusedError(file.name, f"the file is larger than {LARGEST_BYTES} bytes")
        try:
            yield MessageText(f"{package}/msg/{name}", content.decode())
        except UnicodeDecodeError:
            raise DefinitionRefusedError(file.name, "it is not UTF-8 text") from None


def _schema(type_name: str, texts: dict[str, str]) -> str:
    """Return the definition in MCAP's form: the type's own fields, then every other type in a section."""
    others = (f"{SECTION}\nMSG: {name.replace('/msg/', '/')}\n{text}\n" for name, text in texts.items())
    return "\n".join([texts[type_name], *(text for text, name in zip(others, texts, strict=True) if name != type_name)])
