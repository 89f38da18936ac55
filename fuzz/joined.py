"""Fuzzing of the description of a joined recording, and of messages whose stamps it moves.

**Conventions.** The description ends at two zero bytes, a message follows.
"""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from stone_files.joined_file import GIVEN, JOINED, JoinedMember, joined_bytes, read_joined
from stone_recordings.bags.joined.joined_store import member_findings, moved

STAMPED = b"\0\1\0\0" + (1).to_bytes(4, "little") + bytes(4)
TRANSFORM = (
    (1).to_bytes(4, "little") + (1).to_bytes(4, "little") + bytes(4) + b"\2\0\0\0a\0" + bytes(2) + b"\2\0\0\0b\0"
)


def read_description(content: bytes) -> None:
    """Read a description: writing it back must preserve it, and moving a message's stamp its length."""
    text, _, message = content.partition(b"\0\0")
    with TemporaryDirectory() as folder:
        (Path(folder) / JOINED).write_bytes(text)
        members = read_joined(Path(folder))
        (Path(folder) / JOINED).write_bytes(joined_bytes(members))
        if read_joined(Path(folder)) != members:
            raise AssertionError("the written description reads back differently")
    member_findings(members)
    for member in members:
        for places in ("header", "transforms"):
            if len(moved(memoryview(message), places, member.offset_ns)) != len(message):
                raise AssertionError("a message with a moved stamp has another length")


def joined_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield a description of two members, with a message of each kind."""
    members = [JoinedMember("a.mcap"), JoinedMember("b.bag", -80_000_000, 500, (GIVEN,), ("/imu",), {"/tf": ((0, 2),)})]
    for name, message in (("header", STAMPED), ("transforms", b"\0\1\0\0" + TRANSFORM + bytes(60))):
        yield name, joined_bytes(members) + b"\0\0" + message
