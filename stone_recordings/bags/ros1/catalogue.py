"""Places of all messages of a ROS 1 bag: from the index at its end, else by walking the whole file.

**Conventions.** As `stone_recordings.bags.message_places`. The index is believed only where it agrees with itself and
with the heads of the chunks; anything missing or contradictory falls back to the walk, which believes nothing but the
records. So a bag that its recorder did not close, or whose end is missing, is walked whenever it is opened.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stone_recordings.bags.chunks import Chunk
from stone_recordings.bags.errors import CutBagError, EncryptedBagError, MalformedBagError
from stone_recordings.bags.message_places import Entries
from stone_recordings.bags.ros1 import records as wire
from stone_recordings.bags.ros1.draft import Ros1Connection, Ros1Draft
from stone_recordings.bags.ros1.index import read_index
from stone_recordings.bags.ros1.records import Ros1Record
from stone_recordings.bags.ros1.walk import Ros1Walk

BAG_HEADER_BYTES = 4096  # recorders pad it so far, to write it anew when they close the bag


@dataclass(frozen=True, eq=False)
class BagState:
    """`is_closed`: nothing is missing behind the last message. `read_bytes` of the file are whole records.

    `losses` says in words what was broken before that, where the reader asked for what is left.
    """

    is_indexed: bool
    is_closed: bool
    read_bytes: int
    losses: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Ros1Catalogue:
    """What is in the bag and where, by the number of the connection."""

    connections: Mapping[int, Ros1Connection]
    chunks: Sequence[Chunk]
    entries: Mapping[int, Entries]
    state: BagState


def read_ros1_catalogue(view: memoryview, name: str, *, is_tolerant: bool = False) -> Ros1Catalogue:
    """Places in a file that begins with the magic; with `is_tolerant` what is broken is told and passed over.

    Raises: CutBagError (no message is whole), EncryptedBagError, MalformedBagError and the refusals of `inflate`.
    """
    header = _bag_header(view, name)
    index_at, draft = header.fields.u64("index_pos"), Ros1Draft()
    is_there = header.stop <= index_at < len(view)
    if is_there:
        try:
            return _finished(draft, BagState(True, True, read_index(view, header, draft, name)))
        except MalformedBagError:
            pass  # the walk tells what is wrong, if anything is that matters
    walk = Ros1Walk(view, name, draft.starts, is_tolerant=is_tolerant)
    walk.follow(header.stop)
    if is_there and walk.read_bytes < index_at and not is_tolerant:
        raise MalformedBagError(
            name, f"there is no complete record at byte {walk.read_bytes}, the index is at {index_at}"
        )
    if not walk.draft.entries and not is_there:
        raise CutBagError(name, len(view), "it has no complete message")
    is_closed = is_there and index_at <= walk.read_bytes
    return _finished(walk.draft, BagState(False, is_closed, walk.read_bytes, walk.draft.losses))


def _finished(draft: Ros1Draft, state: BagState) -> Ros1Catalogue:
    entries = {number: growing.finished() for number, growing in draft.entries.items()}
    return Ros1Catalogue(draft.connections, draft.chunks, entries, state)


def _bag_header(view: memoryview, name: str) -> Ros1Record:
    try:
        header = wire.record_at(view, len(wire.MAGIC), name)
    except MalformedBagError:
        if len(view) < len(wire.MAGIC) + BAG_HEADER_BYTES:
            raise CutBagError(name, len(view), "its first record is not complete") from None
        raise
    if header.op != wire.BAG_HEADER:
        raise MalformedBagError(name, f"its first record is of op {header.op}, not the header of a bag")
    if encryptor := header.fields.text("encryptor"):
        raise EncryptedBagError(name, encryptor)
    return header
