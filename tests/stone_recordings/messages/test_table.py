"""Any message of any type becomes the columns that rosbags would give, however messages are mixed and damaged."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from stone_recordings.bags.errors import DefinitionMissingError, IngestError, MessageLayoutError
from stone_recordings.messages.types.cdr import MOST_SPLITS
from stone_recordings.messages.types.definition import PRIMITIVES
from stone_recordings.messages.types.registry import MessageText, registry
from stone_recordings.messages.types.table import decode_table
from tests.stone_recordings.messages.oracle import assert_same, read_by_rosbags, wire
from tests.stone_recordings.writing import random_message, serialised

TYPES = tuple(
    name for name, fields in sorted(registry().types.items()) if not {"wstring"} & {field.base for field in fields}
)


def test_the_registry_holds_every_primitive_but_wide_strings() -> None:
    used = {field.base for fields in registry().types.values() for field in fields if "/" not in field.base}
    assert used <= PRIMITIVES
    assert len(TYPES) == len(registry().types) > 180


@pytest.mark.parametrize("part", range(8))
def test_every_known_type_is_what_rosbags_reads(part: int) -> None:
    generator = np.random.default_rng(part)
    for type_name in TYPES[part::8]:
        messages = wire([serialised(random_message(type_name, generator)) for _ in range(5)])
        table = decode_table(type_name, messages)
        assert_same(table, read_by_rosbags(type_name, messages))


PATH = "nav_msgs/msg/Path"
MIXED = (
    "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage", "novatel_oem7_msgs/msg/RXSTATUS",
    "novatel_oem7_msgs/msg/INSCONFIG", "diagnostic_msgs/msg/DiagnosticArray", "gps_msgs/msg/GPSFix",
    "continental_msgs/msg/ContinentalArs548DetectionList", "visualization_msgs/msg/MarkerArray",
    "radar_msgs/msg/RadarTracks", "sensor_msgs/msg/MultiEchoLaserScan", PATH,
)  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(type_name=st.sampled_from(MIXED), seed=st.integers(0, 2**32 - 1), count=st.integers(0, 40))
def test_messages_of_many_lengths_keep_their_order(type_name: str, seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(type_name, generator)) for _ in range(count)])
    assert_same(decode_table(type_name, messages), read_by_rosbags(type_name, messages))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), fields=st.lists(st.sampled_from(sorted(PRIMITIVES - {"string", "wstring"}))))
def test_elements_of_any_alignment_lie_where_rosbags_finds_them(seed: int, fields: list[str]) -> None:
    """A sequence of {any numbers} behind any offset: the strides that CDR's alignment makes are found."""
    inner = "\n".join(f"{kind} f{place}" for place, kind in enumerate(fields)) or "uint8 nothing"
    text = f"string before\nThing[] things\nThing[3] three\nuint8 after\n{'=' * 80}\nMSG: my_msgs/Thing\n{inner}\n"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, "my_msgs/msg/Outer"))
    generator = np.random.default_rng(seed)
    messages = [_outer(store, generator, fields) for _ in range(4)]
    sent = wire([bytes(store.serialize_cdr(message, "my_msgs/msg/Outer")) for message in messages])
    table = decode_table("my_msgs/msg/Outer", sent, registry((MessageText("my_msgs/msg/Outer", text),)))
    assert_same(table, [store.deserialize_cdr(message.payload, "my_msgs/msg/Outer") for message in sent])


def _outer(store, generator, fields):  # type: ignore[no-untyped-def]
    def thing():  # type: ignore[no-untyped-def]
        kinds = {f"f{place}": int(generator.integers(0, 100)) for place in range(len(fields))} or {"nothing": 1}
        return store.types["my_msgs/msg/Thing"](**kinds)

    things = [thing() for _ in range(int(generator.integers(0, 12)))]
    before = "x" * int(generator.integers(0, 9))
    return store.types["my_msgs/msg/Outer"](before=before, things=things, three=[thing() for _ in range(3)], after=7)


@pytest.mark.parametrize("type_name", MIXED)
def test_a_topic_in_portions_is_the_same_table(type_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(6)
    messages = wire([serialised(random_message(type_name, generator)) for _ in range(23)])
    monkeypatch.setattr("stone_recordings.messages.batch.BATCH_BYTES", 3 * len(messages[0].payload))
    assert_same(decode_table(type_name, messages), read_by_rosbags(type_name, messages))


def test_only_the_columns_that_are_asked_for_are_made() -> None:
    messages = wire([serialised(random_message(PATH, np.random.default_rng(4))) for _ in range(9)])
    table = decode_table(PATH, messages, only=("header.stamp", "poses.pose.position"))
    whole = decode_table(PATH, messages)
    assert set(table.columns) == {"header.stamp.sec", "header.stamp.nanosec"} | {
        f"poses.pose.position.{axis}" for axis in "xyz"
    }
    for name in ("poses.pose.position.x",):
        assert table.ragged(name)[1].tobytes() == whole.ragged(name)[1].tobytes()


def test_a_column_of_another_kind_is_refused_by_name() -> None:
    """An embedded definition can lack what a decoder needs, or make another thing of it."""
    table = decode_table(PATH, wire([serialised(random_message(PATH, np.random.default_rng(4)))]))
    for read, sentence in (
        (lambda: table.numbers("header.frame_id"), r"does not declare header.frame_id as a number"),
        (lambda: table.numbers("header.stamp.sec", 9), r"does not declare header.stamp.sec as an array of 9"),
        (lambda: table.texts("header.stamp.sec"), r"does not declare header.stamp.sec as a string"),
        (lambda: table.ragged("header.stamp.sec"), r"does not declare header.stamp.sec as a sequence of numbers"),
        (
            lambda: table.ragged_texts("poses.pose.position.x"),
            r"does not declare poses.pose.* as a sequence of strings",
        ),
        (lambda: table.numbers("latitude"), r"its definition has no latitude"),
    ):
        with pytest.raises(MessageLayoutError, match=sentence):
            read()


def test_no_messages_are_a_table_of_none() -> None:
    table = decode_table("tf2_msgs/msg/TFMessage", [])
    assert table.count == 0
    assert table.ragged_texts("transforms.header.frame_id")[1] == []


def test_a_type_that_nobody_described_is_refused() -> None:
    with pytest.raises(DefinitionMissingError, match=r"no definition of 'my_msgs/msg/Thing' is known"):
        decode_table("my_msgs/msg/Thing", [])


@settings(max_examples=250, deadline=None)
@given(
    type_name=st.sampled_from(MIXED),
    seed=st.integers(0, 2**32 - 1),
    ratio=st.floats(0, 1, exclude_max=True),
    junk=st.binary(max_size=8),
    is_cut=st.booleans(),
)
def test_damaged_messages_are_read_or_refused_by_code(
    type_name: str, seed: int, ratio: float, junk: bytes, is_cut: bool
) -> None:
    generator = np.random.default_rng(seed)
    whole, other = (serialised(random_message(type_name, generator)) for _ in range(2))
    at = int(ratio * len(whole))
    damaged = whole[:at] + junk + (b"" if is_cut else whole[at + len(junk) :])
    code = "MSG-3"
    try:
        decode_table(type_name, wire([other, damaged]))
    except IngestError as error:
        code = error.code
    assert code.startswith("MSG-3")


def test_a_count_of_billions_is_refused_before_anything_is_made() -> None:
    whole = serialised(random_message(PATH, np.random.default_rng(1)))
    body = whole[:12] + (1).to_bytes(4, "little") + b"\0" + b"\0\0\0" + (0xFFFFFFFF).to_bytes(4, "little")
    with pytest.raises(MessageLayoutError, match=r"a sequence declares 4294967295 elements, 0 bytes are left"):
        decode_table(PATH, wire([body]))


def _strings(count: int) -> bytes:
    """A message of one sequence of empty strings."""
    return b"\0\1\0\0" + count.to_bytes(4, "little") + b"\1\0\0\0\0\0\0\0" * count


def test_layouts_that_outgrow_their_messages_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stone_recordings.messages.types.sketch.MOST_WALKED", 1000)
    monkeypatch.setattr("stone_recordings.messages.types.table.MOST_PIECES", 5000)
    known = registry((MessageText("my_msgs/msg/Words", "string[] words"),))
    words = decode_table("my_msgs/msg/Words", wire([_strings(3), _strings(0)]), known).ragged_texts("words")
    assert (words[0].tolist(), words[1]) == ([0, 3, 3], ["", "", ""])
    with pytest.raises(MessageLayoutError, match=r"words has 1001 elements of varying size, 1000 are read"):
        decode_table("my_msgs/msg/Words", wire([_strings(1001)]), known)
    many = wire([_strings(600 + place) for place in range(9)])
    with pytest.raises(MessageLayoutError, match=r"9 messages of different layouts have more than 5000 parts"):
        decode_table("my_msgs/msg/Words", many, known)


def test_texts_that_never_have_the_same_lengths_cost_no_more_than_a_walk_each() -> None:
    """2,000 messages of one size, each with its own split of it: beyond a few splits they are measured one by one."""
    count = 40 * MOST_SPLITS
    messages = []
    for place in range(count):
        first, second = b"a" * (4 * place + 3) + b"\0", b"b" * (4 * (count - place) + 3) + b"\0"
        texts = b"".join(len(text).to_bytes(4, "little") + text for text in (first, second))
        messages.append(b"\0\1\0\0" + texts)
    table = decode_table("diagnostic_msgs/msg/KeyValue", wire(messages))
    assert [len(text) for text in table.texts("key")] == [4 * place + 3 for place in range(count)]
    assert [len(text) for text in table.texts("value")] == [4 * (count - place) + 3 for place in range(count)]
