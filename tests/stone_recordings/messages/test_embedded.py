"""A recording's own definition is followed or refused by code, whatever it makes of the fields that are needed."""

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
from stone_recordings.messages.types.registry import MessageText, message_definition, registry
from stone_recordings.messages.types.table import decode_table
from tests.stone_recordings.messages.oracle import Message, damaged_in_turn, wire
from tests.stone_recordings.writing import random_message, serialised

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


@settings(max_examples=60, deadline=None)
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
    with pytest.raises(MessageLayoutError, match=rf"does not declare nov_header\.{field} as an integer"):
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


def test_an_uploaded_definition_reads_what_nobody_knew() -> None:
    text = "std_msgs/Header header\nfloat32[] values\nstring name"
    known = registry((MessageText("my_msgs/msg/Thing", text),))
    body = b"\0\1\0\0" + bytes(8) + b"\2\0\0\0a\0\0\0" + b"\2\0\0\0" + np.float32([1.5, 2.5]).tobytes() + b"\2\0\0\0b\0"
    table = decode_table("my_msgs/msg/Thing", wire([body]), known)
    assert table.ragged("values")[1].tolist() == [1.5, 2.5]
    assert table.texts("name") == ["b"]


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
