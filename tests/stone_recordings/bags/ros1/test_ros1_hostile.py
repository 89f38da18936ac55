"""What cannot be a ROS 1 bag is refused by its code, and nothing that a bag claims costs more than its bytes do."""

import bz2
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cramjam
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.errors import StoneError
from stone_recordings.bags import errors
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.bags.ros1.records import MAGIC
from stone_recordings.report.inspection import inspect
from testing.refusals import refused_as
from tests.stone_recordings.bags.memory_growth import GROWTH_LIMIT_BYTES, growth_of

DESCRIPTION = {"topic": b"/text", "type": b"std_msgs/String", "md5sum": b"0", "message_definition": b"string data\n"}


def header(**fields: bytes) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(len(part).to_bytes(4, "little") + part for part in parts)


def record(op: int, data: bytes = b"", **fields: bytes) -> bytes:
    head = header(op=bytes([op]), **fields)
    return len(head).to_bytes(4, "little") + head + len(data).to_bytes(4, "little") + data


def u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def bag_header(index_at: int = 0, connections: int = 0, chunks: int = 0, **more: bytes) -> bytes:
    told = {"index_pos": index_at.to_bytes(8, "little"), "conn_count": u32(connections), "chunk_count": u32(chunks)}
    return MAGIC + record(3, b" " * 100, **told, **more)


def connection(number: int = 0, **changed: bytes) -> bytes:
    return record(7, header(**DESCRIPTION | changed), conn=u32(number), topic=changed.get("topic", b"/text"))


def text(value: bytes = b"hello", number: int = 0, sec: int = 5) -> bytes:
    return record(2, u32(len(value)) + value, conn=u32(number), time=struct.pack("<II", sec, 0))


def chunk(compression: bytes, declared_bytes: int, packed: bytes) -> bytes:
    return record(5, packed, compression=compression, size=u32(declared_bytes))


def packed(compression: str, content: bytes) -> bytes:
    return bz2.compress(content) if compression == "bz2" else bytes(cramjam.lz4.compress(content))


def written(folder: Path, content: bytes) -> Path:
    path = folder / "run.bag"
    path.write_bytes(content)
    return path


def test_messages_outside_of_chunks_are_read_and_an_index_that_agrees_with_itself_is_believed(tmp_path: Path) -> None:
    with open_bag(written(tmp_path, bag_header() + connection() + text() + text(b"world", sec=4))) as bag:
        found = [bytes(message.payload) for message in bag.messages("/text")]
        assert found == [b"\0\1\0\0\6\0\0\0world\0", b"\0\1\0\0\6\0\0\0hello\0"]
        assert (bag.start_ns, bag.end_ns) == (4_000_000_000, 5_000_000_000)
    with open_bag(written(tmp_path, _indexed(*WHOLE))) as bag:
        assert bag.is_indexed
        assert bytes(bag.message("/text", 0).payload).endswith(b"hello\0")


@pytest.mark.parametrize(
    ("content", "refusal"),
    [
        (MAGIC[:7], "BAG-010"),
        (MAGIC, "BAG-010"),
        (bag_header()[:60], "BAG-010"),
        (bag_header(), "BAG-010"),
        (bag_header() + connection(), "BAG-010"),
        (bag_header(encryptor=b"rosbag/AesCbcEncryptor") + connection() + text(), "BAG-036"),
        (b"#ROSBAG V1.2\n" + bytes(100), "BAG-001"),
        (b"#ROSRECORD V1.1\n" + bytes(100), "BAG-001"),
        (MAGIC + record(5, bytes(9)), "BAG-012"),
        (MAGIC + record(3, bytes(9)), "BAG-012"),
        (MAGIC + u32(3) + bytes(5000), "BAG-012"),
        (MAGIC + u32(1 << 30) + bytes(5000), "BAG-012"),
        (bag_header() + text(), "BAG-012"),
        (bag_header() + connection() + connection(type=b"std_msgs/Int8") + text(), "BAG-012"),
        (bag_header(700, 1, 1) + connection() + bytes(900), "BAG-012"),
        (bag_header() + connection() + record(2, bytes(9)), "BAG-012"),
    ],
)  # fmt: skip
def test_each_refusal_has_its_code_and_its_words(tmp_path: Path, content: bytes, refusal: str) -> None:
    with refused_as(refusal):
        open_bag(written(tmp_path, content))


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
@pytest.mark.parametrize("declared_bytes", [10, 999, 1001, 100_000_000])
def test_a_chunk_that_inflates_to_another_size_is_refused(tmp_path, compression, declared_bytes):
    content = chunk(compression.encode(), declared_bytes, packed(compression, bytes(1000)))
    with pytest.raises(errors.MalformedBagError):
        open_bag(written(tmp_path, bag_header() + content))


def test_a_compression_that_is_none_of_ros1_is_named(tmp_path: Path) -> None:
    with refused_as("BAG-017"):
        open_bag(written(tmp_path, bag_header() + chunk(b"zstd", 10, b"0123456789") + connection()))


def _bomb(compression: str, declared_bytes: int, true_bytes: int) -> Callable[[], bytes]:
    return lambda: bag_header() + chunk(compression.encode(), declared_bytes, packed(compression, bytes(true_bytes)))


def _unended_bomb() -> bytes:
    """A chunk whose length is not written yet, of one message of 120 MB."""
    head = text(b"")[: -len(u32(0)) - 4]
    content = packed("lz4", connection() + head + u32(120_000_004) + u32(120_000_000) + bytes(120_000_000))
    return bag_header() + chunk(b"lz4", 0, b"") + content


BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "four gigabytes": ("BAG-013", _bomb("bz2", 4_000_000_000, 1_000_000)),
    "lz4 that grows beyond its word": ("BAG-012", _bomb("lz4", 100_000_000, 150_000_000)),
    "a chunk that never ends": ("BAG-010", _unended_bomb),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", BOMBS)
def test_a_refusal_costs_little_memory(tmp_path: Path, name: str) -> None:
    """Catches alone memory that is allocated by what a chunk says of itself."""
    code, content = BOMBS[name]
    said, growth_bytes = growth_of(written(tmp_path, content()))
    assert said == code
    assert growth_bytes <= GROWTH_LIMIT_BYTES


def _indexed(chunks: bytes, infos: bytes, count: int) -> bytes:
    """A closed bag; the index behind the chunks is what it says."""
    body = len(bag_header(0, 1, 1)) + len(chunks)
    return bag_header(body, 1, count) + chunks + connection() + infos


def _rows(*rows: tuple[int, int], number: int = 0) -> bytes:
    """The index of a chunk's messages: (sec, offset)."""
    data = b"".join(struct.pack("<III", sec, 0, offset) for sec, offset in rows)
    return record(4, data, ver=u32(1), conn=u32(number), count=u32(len(rows)))


def _info(at: int, count: int, number: int = 0) -> bytes:
    told = {"ver": u32(1), "chunk_pos": at.to_bytes(8, "little"), "count": u32(1)}
    return record(6, u32(number) + u32(count), **told, start_time=bytes(8), end_time=bytes(8))


START = len(bag_header(0, 1, 1))
INNER = connection() + text()
CHUNK = chunk(b"none", len(INNER), INNER)
WHOLE = (CHUNK + _rows((5, len(connection()))), _info(START, 1), 1)


SOUND = (
    _indexed(*WHOLE),
    bag_header() + chunk(b"lz4", len(INNER), packed("lz4", INNER)) + CHUNK,
    bag_header() + chunk(b"bz2", len(INNER), packed("bz2", INNER)) + CHUNK,
    bag_header() + INNER + text(b"again"),
)


@pytest.mark.parametrize(
    "told",
    [
        (CHUNK + _rows((5, 0), number=3), _info(START, 1), 1), (CHUNK + _rows((5, 0), (5, 0)), _info(START, 1), 1),
        (CHUNK + _rows((5, 0), number=9), _info(START, 1, number=9), 1),
        (CHUNK + _rows((5, 0)), _info(START - 30, 1), 1), (CHUNK + _rows((5, 0)), _info(2**60, 1), 1),
        (CHUNK + _rows((5, 0)), _info(START, 1) * 2, 2), (CHUNK + _rows((5, 0)), _info(START, 1), 1000),
        (CHUNK, _info(START, 1), 1),
    ],
)  # fmt: skip
def test_an_index_that_contradicts_itself_is_not_needed(tmp_path: Path, told: tuple[bytes, bytes, int]) -> None:
    with open_bag(written(tmp_path, _indexed(*told))) as bag:
        assert not bag.is_indexed
        assert [bytes(message.payload)[8:] for message in bag.messages("/text")] == [b"hello\0"]


@pytest.mark.parametrize("row", [(5, 0), (5, 10_000), (5, 2**32 - 1), (6, len(connection()))])
def test_an_index_that_lies_about_a_message_is_found_out_when_that_is_read(tmp_path, row):
    with open_bag(written(tmp_path, _indexed(CHUNK + _rows(row), _info(START, 1), 1))) as bag:
        with pytest.raises(errors.MalformedBagError):
            bag.message("/text", 0)
        with pytest.raises(errors.MalformedBagError):
            list(bag.heads(["/text"]))


@pytest.mark.parametrize(("tail", "severity"), [(bytes(70), "info"), (b"junk" * 9, "warning")])
def test_what_follows_the_end_is_said(tmp_path: Path, tail: bytes, severity: str) -> None:
    with open_bag(written(tmp_path, _indexed(*WHOLE) + tail)) as bag:
        (finding,) = bag.findings
        assert (finding.code, finding.severity) == ("BAG-032", severity)
        assert f"{len(tail)} " in finding.message


def test_topics_that_nobody_can_read_are_left_out_by_name_and_the_others_are_read(tmp_path: Path) -> None:
    unread = {
        b"/cycle": {"type": b"acme_msgs/Own", "message_definition": b"Own own\n"},
        b"/nothing": {"type": b"acme_msgs/Own", "message_definition": b""},
        b"/nameless": {"type": b"?", "message_definition": b"uint8 x\n"},
    }
    content = bag_header() + connection() + text()
    for number, (topic, told) in enumerate(unread.items(), 1):
        content += connection(number, topic=topic, **told) + text(number=number)
    content += connection(7, topic=b"/two") + connection(
        8, topic=b"/two", type=b"std_msgs/Int8", message_definition=b"int8 data"
    )
    inspection = inspect(written(tmp_path, content + text(number=7) + text(number=8)))
    said = {(finding.code, finding.topic) for finding in inspection.findings}
    assert {("MSG-307", "/cycle"), ("BAG-020", "/nothing"), ("MSG-307", "/nameless"), ("BAG-012", "/two")} <= said
    assert {topic for code, topic in said if code == "BAG-014"} == {"/cycle", "/nothing", "/nameless", "/two"}
    assert [part.topic.count for part in inspection.topics if part.topic.name == "/text"] == [1]


@given(data=st.data())
def test_whatever_is_damaged_a_bag_is_read_or_refused_by_a_code(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    content = bytearray(data.draw(st.sampled_from(SOUND)))
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = written(folder, bytes(content[: data.draw(st.integers(1, len(content)))]))
    with suppress(StoneError):
        inspect(path)
    with suppress(StoneError):
        recover(path, folder / "out.mcap")
