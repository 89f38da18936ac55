"""Any message of any type becomes the columns that rosbags would give, however messages are mixed and damaged."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.bags.errors import IngestError, MessageLayoutError
from stone_recordings.messages.camera_info import decode_camera_info
from stone_recordings.messages.gnss import decode_gnss
from stone_recordings.messages.novatel import decode_bestpos, decode_inspva
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.types.cdr import MOST_SPLITS
from stone_recordings.messages.types.definition import PRIMITIVES
from stone_recordings.messages.types.registry import MessageText, message_definition, registry
from stone_recordings.messages.types.table import decode_table
from tests.stone_recordings.messages.oracle import Message, assert_same, damaged_in_turn, read_by_rosbags, wire
from tests.stone_recordings.writing import random_message, serialised

TYPES = tuple(
    name for name, fields in sorted(registry().types.items()) if not {"wstring"} & {field.base for field in fields}
)


@pytest.mark.whole
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


@settings(max_examples=40)
@given(type_name=st.sampled_from(MIXED), seed=st.integers(0, 2**32 - 1), count=st.integers(0, 40))
def test_messages_of_many_lengths_keep_their_order(type_name: str, seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(type_name, generator)) for _ in range(count)])
    assert_same(decode_table(type_name, messages), read_by_rosbags(type_name, messages))


@settings(max_examples=30)
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


def test_only_the_columns_that_are_asked_for_are_made_and_of_their_kind() -> None:
    messages = wire([serialised(random_message(PATH, np.random.default_rng(4))) for _ in range(9)])
    table = decode_table(PATH, messages, only=("header.stamp", "poses.pose.position"))
    whole = decode_table(PATH, messages)
    assert set(table.columns) == {"header.stamp.sec", "header.stamp.nanosec"} | {
        f"poses.pose.position.{axis}" for axis in "xyz"
    }
    for name in ("poses.pose.position.x",):
        assert table.ragged(name)[1].tobytes() == whole.ragged(name)[1].tobytes()
    # An embedded definition can lack what a decoder needs, or make another thing of it.
    table = decode_table(PATH, wire([serialised(random_message(PATH, np.random.default_rng(4)))]))
    for read in (
        lambda: table.numbers("header.frame_id"), lambda: table.numbers("header.stamp.sec", 9),
        lambda: table.texts("header.stamp.sec"), lambda: table.ragged("header.stamp.sec"),
        lambda: table.ragged_texts("poses.pose.position.x"), lambda: table.numbers("latitude"),
    ):  # fmt: skip
        with pytest.raises(MessageLayoutError):
            read()


def test_no_messages_are_a_table_of_none_and_a_count_of_billions_is_refused() -> None:
    table = decode_table("tf2_msgs/msg/TFMessage", [])
    assert table.count == 0
    assert table.ragged_texts("transforms.header.frame_id")[1] == []
    whole = serialised(random_message(PATH, np.random.default_rng(1)))
    body = whole[:12] + (1).to_bytes(4, "little") + b"\0" + b"\0\0\0" + (0xFFFFFFFF).to_bytes(4, "little")
    with pytest.raises(MessageLayoutError):
        decode_table(PATH, wire([body]))


@settings(max_examples=120)
@given(
    type_name=st.sampled_from(MIXED),
    seed=st.integers(0, 2**32 - 1),
    ratio=st.floats(0, 1, exclude_max=True),
    junk=st.binary(max_size=8),
    is_cut=st.booleans(),
)
def test_damaged_messages_are_read_or_refused_by_code(type_name, seed, ratio, junk, is_cut):
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


def _strings(count: int) -> bytes:
    """A message of one sequence of empty strings."""
    return b"\0\1\0\0" + count.to_bytes(4, "little") + b"\1\0\0\0\0\0\0\0" * count


def test_layouts_that_outgrow_their_messages_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stone_recordings.messages.types.sketch.MOST_WALKED", 1000)
    monkeypatch.setattr("stone_recordings.messages.types.table.MOST_PIECES", 5000)
    known = registry((MessageText("my_msgs/msg/Words", "string[] words"),))
    words = decode_table("my_msgs/msg/Words", wire([_strings(3), _strings(0)]), known).ragged_texts("words")
    assert (words[0].tolist(), words[1]) == ([0, 3, 3], ["", "", ""])
    with pytest.raises(MessageLayoutError):
        decode_table("my_msgs/msg/Words", wire([_strings(1001)]), known)
    many = wire([_strings(600 + place) for place in range(9)])
    with pytest.raises(MessageLayoutError):
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


KINDS = ("uint8", "float64", "string", "float32[]", "int64[3]", "float32", "bool", "uint32", "int8[2]")
SIGNALLING = b"\0\0\xa0\x7f"
TIME = "int32 sec\nuint32 nanosec"
FIX = "sensor_msgs/msg/NavSatFix"
DECODERS: dict[str, Callable[[list[Message], str], Any]] = {
    FIX: lambda messages, schema: decode_gnss(FIX, messages, schema),
    "sensor_msgs/msg/CameraInfo": decode_camera_info,
    "novatel_oem7_msgs/msg/INSPVAX": decode_inspva,
    "novatel_oem7_msgs/msg/BESTPOS": decode_bestpos,
} | {
    name: lambda messages, schema, name=name: decode_radar(name, messages, schema)  # type: ignore[misc]
    for name in (
        "radar_msgs/msg/RadarScan",
        "continental_msgs/msg/ContinentalArs548DetectionList",
        "nebula_msgs/msg/NebulaPackets",
    )
}


def _bent(text: str, line: int, kind: str) -> str:
    """One field of another kind."""
    lines = text.splitlines()
    fields = [at for at, content in enumerate(lines) if content and "=" not in content and ":" not in content]
    at = fields[line % len(fields)]
    lines[at] = f"{kind} {lines[at].split()[1]}"
    return "\n".join(lines)


@settings(max_examples=30)
@given(
    type_name=st.sampled_from(sorted(DECODERS)),
    seed=st.integers(0, 2**32 - 1),
    line=st.integers(0, 60),
    kind=st.sampled_from(KINDS),
)
def test_a_definition_of_another_kind_is_followed_or_refused(type_name: str, seed: int, line: int, kind: str) -> None:
    """Messages are written by the bent definition, so that lengths agree and only kinds do not."""
    text = _bent(message_definition(type_name), line, kind)
    store = _store_of(text, type_name)
    generator = np.random.default_rng(seed)
    sent = wire([bytes(store.serialize_cdr(random_message(type_name, generator, store=store), type_name))])
    code = "MSG-3"
    try:
        DECODERS[type_name](sent, text)
    except IngestError as error:
        code = error.code
    assert code.startswith("MSG-3")


@pytest.mark.parametrize("field", ["gps_week_number", "gps_week_milliseconds"])
def test_a_gps_time_of_fractions_is_refused(field: str) -> None:
    """A NaN among them has no whole number that it could be cast to."""
    type_name = "novatel_oem7_msgs/msg/BESTPOS"
    text = re.sub(rf"\w+(?= {field}\b)", "float64", message_definition(type_name))
    store = _store_of(text, type_name)
    message = random_message(type_name, np.random.default_rng(1), store=store)
    with pytest.raises(MessageLayoutError):
        decode_bestpos(wire([bytes(store.serialize_cdr(message, type_name))]), text)


def _store_of(text: str, type_name: str) -> Typestore:
    """What rosbags knows of these definitions and no others, the bent time included."""
    store = get_typestore(Stores.EMPTY)
    store.fielddefs, store.types, store.cache = {}, {}, {}
    store.register({**get_types_from_msg(TIME, "builtin_interfaces/msg/Time"), **get_types_from_msg(text, type_name)})
    return store


@pytest.mark.parametrize("line", range(60))
def test_a_detection_list_of_another_kind_is_refused(line: int) -> None:
    """Written by the true definition, read by the bent one: lengths, kinds and places are checked before bytes are."""
    type_name = "ars548_messages/msg/DetectionList"
    text = message_definition(type_name).replace("[800]", "[9]")
    small = _message_of_nine(text)
    for kind in KINDS:
        code = "MSG-3"
        try:
            decode_radar(type_name, small, _bent(text, line, kind))
        except IngestError as error:
            code = error.code
        assert code.startswith("MSG-3")


def _message_of_nine(text: str) -> list[Message]:
    type_name = "ars548_messages/msg/DetectionList"
    store = _store_of(text, type_name)
    message = random_message(type_name, np.random.default_rng(0), store=store)
    message.list_numofdetections = 7
    sent = wire([bytes(store.serialize_cdr(message, type_name))])
    assert decode_radar(type_name, sent, text).counts.tolist() == [7]
    return sent


SMALL = ("tf2_msgs/msg/TFMessage", "novatel_oem7_msgs/msg/RXSTATUS", "gps_msgs/msg/GPSFix", "radar_msgs/msg/RadarScan")


@pytest.mark.parametrize("type_name", SMALL)
def test_every_byte_may_be_cut_or_turned(type_name: str) -> None:
    """No damage of one byte is anything but read or refused by code, and a cut before the padding is refused."""
    whole = serialised(random_message(type_name, np.random.default_rng(3), is_tame=True))
    refused = damaged_in_turn(whole, lambda content: decode_table(type_name, wire([content])), (IngestError,))
    assert refused >= len(whole) - 4


def test_a_signalling_nan_is_as_good_as_any_other() -> None:
    """Damage makes them; numpy warns of them where a float becomes a double, and a warning is an error here."""
    fix = random_message("novatel_oem7_msgs/msg/BESTPOS", np.random.default_rng(0), is_tame=True)
    fix.sol_status.status, fix.pos_type.type, fix.lat_stdev = 0, 50, 1.25
    damaged = serialised(fix).replace(np.float32(1.25).tobytes(), SIGNALLING)
    assert np.isnan(decode_bestpos(wire([damaged])).position_stdev_m[0, 0])
    scan = random_message("radar_msgs/msg/RadarScan", np.random.default_rng(1), is_tame=True)
    scan.returns = [random_message("radar_msgs/msg/RadarReturn", np.random.default_rng(2), is_tame=True)]
    scan.returns[0].azimuth = 1.25
    damaged = serialised(scan).replace(np.float32(1.25).tobytes(), SIGNALLING)
    ours = decode_radar("radar_msgs/msg/RadarScan", wire([damaged]))
    assert np.isnan(ours.points_radar[0, 0])
    assert not ours.is_valid[0]
