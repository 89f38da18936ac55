"""Every novatel_oem7_msgs type decodes and equals rosbags: on the driver's recordings, and on generated messages."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.camera_info import decode_camera_info
from stone_recordings.messages.gnss import GNSS_TYPES, NAVSATFIX, decode_gnss
from stone_recordings.messages.novatel import (
    PACKAGE,
    decode_inspva,
    decode_novatel,
    gps_stamps_ns,
    leap_seconds,
    older,
    unix_ns,
)
from stone_recordings.messages.types.definition import Field, parsed
from stone_recordings.messages.types.registry import MessageText, registry, typestore
from tests.stone_recordings.messages.oracle import Message, assert_same, read_by_rosbags, wire
from tests.stone_recordings.writing import random_message, serialised

TYPES = sorted(name for name in registry().types if name.startswith(PACKAGE))
LOGS = [name for name in TYPES if any(field.name == "nov_header" for field in registry().types[name])]
ROS1_BAGS = ("align", "bestpos", "ins1", "ins2", "rxstatus", "time")
# What the driver's test recordings hold, by name and number of messages.
RECORDED = {
    "HEADING2": 12, "INSPVA": 10, "BESTPOS": 5, "BESTVEL": 5, "BESTUTM": 2, "INSCONFIG": 2, "INSSTDEV": 29,
    "CORRIMU": 776, "INSPVAX": 6, "RXSTATUS": 3, "TIME": 6,
}  # fmt: skip


def _tamed(message: Any) -> Any:
    """Random bits, but status words and angles as a receiver could send them."""
    for name in ("sol_status", "ins_status", "p_sol_status"):
        if hasattr(message, name):
            getattr(message, name).status = 3
    for name in ("pos_type", "vel_type"):
        if hasattr(message, name):
            getattr(message, name).type = 56
    for name in ("lat", "lon", "latitude", "longitude", "heading", "azimuth", "trk_gnd"):
        if hasattr(message, name):
            setattr(message, name, 7.5)
    return message


@pytest.mark.parametrize("type_name", TYPES)
def test_every_type_is_what_rosbags_reads(type_name: str) -> None:
    generator = np.random.default_rng(11)
    messages = wire([serialised(_tamed(random_message(type_name, generator))) for _ in range(6)])
    assert_same(decode_novatel(type_name, messages), read_by_rosbags(type_name, messages))


@pytest.mark.parametrize("type_name", LOGS)
def test_every_log_has_the_time_of_its_gps_week(type_name: str) -> None:
    message = _tamed(random_message(type_name, np.random.default_rng(3)))
    message.nov_header.gps_week_number, message.nov_header.gps_week_milliseconds = 2300, 345_600_250
    stamps_ns = gps_stamps_ns(decode_novatel(type_name, wire([serialised(message)])))
    assert stamps_ns.tolist() == [(315_964_800 + 2300 * 604_800 + 345_600 - 18) * 10**9 + 250_000_000]


@pytest.mark.field_data
def test_the_drivers_folder_of_definitions_is_ours_of_the_older_version(field_data: Path) -> None:
    """All 29 files, field by field; ours of Humble differ in the header and in the station ids, as its branch does."""
    folder = field_data / "novatel_oem7/novatel_oem7_msgs/msg"
    files = sorted(folder.glob("*.msg"))
    assert len(files) == 29
    for file in files:
        name = f"{PACKAGE}{file.stem}"
        theirs = parsed(file.read_text(), name)[name]
        assert older().types[name] == theirs
        humble = [field for field in registry().types[name] if field.name not in ("receiver_status", "idle_time")]
        assert [field.name for field in humble] == [field.name for field in theirs]
        changed = {field.name for field, old in zip(humble, theirs, strict=True) if field != old}
        assert changed <= {"stn_id", "rover_stn_id", "master_stn_id"}
    assert Field("receiver_status", "uint32") in registry().types[f"{PACKAGE}Oem7Header"]


def _ros1_messages(field_data: Path) -> Iterator[tuple[str, Typestore, list[Message]]]:
    """(type, a store that knows the recording's own definition, CDR messages) of every topic of the driver's bags."""
    for name in ROS1_BAGS:
        with Reader(field_data / f"novatel_oem7/novatel_oem7_driver/test/{name}.bag") as reader:
            for connection in reader.connections:
                if not connection.msgtype.startswith(PACKAGE):
                    continue
                store = get_typestore(Stores.ROS2_HUMBLE)
                types = get_types_from_msg(_without_sequence_number(connection.msgdef.data), connection.msgtype)
                store.register({key: value for key, value in types.items() if key not in store.fielddefs})
                raw = [payload for _, _, payload in reader.messages([connection])]
                source = get_typestore(Stores.ROS1_NOETIC)
                own = get_types_from_msg(connection.msgdef.data, connection.msgtype)
                source.register({key: value for key, value in own.items() if key not in source.fielddefs})
                cdr = [_as_cdr(source.deserialize_ros1(payload, connection.msgtype), store) for payload in raw]
                yield connection.msgtype, store, wire(cdr)


def _without_sequence_number(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if line.split("#")[0].split() != ["uint32", "seq"])


def _as_cdr(message: Any, store: Typestore) -> bytes:
    return bytes(store.serialize_cdr(_moved(message, store), message.__msgtype__))


def _moved(value: Any, store: Typestore) -> Any:
    """A ROS 1 message in the classes of a ROS 2 store."""
    if isinstance(value, list):
        return [_moved(element, store) for element in value]
    if not hasattr(value, "__msgtype__"):
        return value
    names = [name for name, _kind in store.fielddefs[value.__msgtype__][1]]
    return store.types[value.__msgtype__](**{name: _moved(getattr(value, name), store) for name in names})


@pytest.mark.whole
@pytest.mark.field_data
def test_the_drivers_ros1_bags_are_what_rosbags_reads(field_data: Path) -> None:
    """Without their definitions: the older version is told apart by what the messages say."""
    counts: dict[str, int] = {}
    for type_name, store, messages in _ros1_messages(field_data):
        table = decode_novatel(type_name, messages)
        assert_same(table, [store.deserialize_cdr(message.payload, type_name) for message in messages])
        assert (np.diff(gps_stamps_ns(table)) >= 0).all()
        counts[type_name.removeprefix(PACKAGE)] = counts.get(type_name.removeprefix(PACKAGE), 0) + table.count
    assert counts == RECORDED


@pytest.mark.field_data
def test_converted_recordings_are_read_by_the_definition_that_they_embed(field_data: Path) -> None:
    for folder in ("bestpos", "ins2"):
        with open_bag(field_data / f"novatel_oem7/{folder}_ros2_mcap/{folder}_ros2_mcap.mcap") as bag:
            for topic in bag.topics:
                if not topic.type.startswith(PACKAGE):
                    continue
                store = get_typestore(Stores.ROS2_HUMBLE)
                store.register(get_types_from_msg(topic.schema, topic.type))
                messages = list(bag.messages(topic.name))
                theirs = [store.deserialize_cdr(message.payload, topic.type) for message in messages]
                assert_same(decode_novatel(topic.type, messages, topic.schema), theirs)
                assert_same(decode_novatel(topic.type, messages), theirs)


def test_an_embedded_definition_is_followed_whatever_is_known_here() -> None:
    """A field moved: only the recording knows."""
    text = "float64 azimuth\nstd_msgs/Header header\nOem7Header nov_header\n" + "\n".join(
        line for line in _body("INSPVA") if "azimuth" not in line and "header" not in line
    )
    type_name = f"{PACKAGE}INSPVA"
    moved = registry((MessageText(type_name, text),))
    assert moved.types[type_name][0] == Field("azimuth", "float64")
    store = get_typestore(Stores.ROS2_HUMBLE)
    known = {name: _text(name) for name in (f"{PACKAGE}Oem7Header", f"{PACKAGE}InertialSolutionStatus")}
    for name, definition in {**known, type_name: text}.items():
        store.register(get_types_from_msg(definition, name))
    message = _moved(_tamed(random_message(type_name, np.random.default_rng(2))), store)
    payload = bytes(store.serialize_cdr(message, type_name))
    assert decode_inspva(wire([payload]), text).azimuth_deg.tolist() == [7.5]


def _body(name: str) -> list[str]:
    return _text(f"{PACKAGE}{name}").splitlines()


def _text(type_name: str) -> str:
    marks = {"one": "", "sequence": "[]"}
    return "\n".join(
        f"{field.base.replace('/msg/', '/')}{marks.get(field.kind, f'[{field.length}]')} {field.name}"
        for field in registry().types[type_name]
    )


INFO = "sensor_msgs/msg/CameraInfo"
SAME = {"latitude_deg": "latitude", "longitude_deg": "longitude", "height_m": "altitude"}
MOTION = {"speed_m_s": "speed", "track_deg": "track", "climb_m_s": "climb"}
seeds, counts = st.integers(0, 2**32 - 1), st.integers(0, 8)


def _check(ours: Any, theirs: list[Any], names: dict[str, str]) -> None:
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in theirs]
    assert ours.stamps_ns.tolist() == stamps
    for mine, name in names.items():
        expected = np.array([getattr(message, name) for message in theirs], np.float64)
        assert getattr(ours, mine).tobytes() == expected.tobytes()
    assert ours.status.tolist() == [message.status.status for message in theirs]
    covariances = np.array([message.position_covariance for message in theirs], np.float64)
    assert ours.covariance_enu_m2.tobytes() == covariances.tobytes()


@settings(max_examples=30)
@given(type_name=st.sampled_from(sorted(GNSS_TYPES)), seed=seeds, count=counts)
def test_positions_are_what_rosbags_reads(type_name: str, seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    messages = wire([serialised(random_message(type_name, generator)) for _ in range(count)])
    ours = decode_gnss(type_name, messages)
    names = SAME if type_name == NAVSATFIX else SAME | MOTION
    _check(ours, read_by_rosbags(type_name, messages), names)
    assert (ours.speed_m_s is None) == (type_name == NAVSATFIX)
    assert ours.height_above == ("ellipsoid" if type_name == NAVSATFIX else "mean sea level")


def test_a_position_without_fix_or_without_number_is_none() -> None:
    messages = [random_message(NAVSATFIX, np.random.default_rng(1), is_tame=True) for _ in range(3)]
    for message, status in zip(messages, (-1, 0, 2), strict=True):
        message.status.status = status
    messages[2].longitude = float("nan")
    ours = decode_gnss(NAVSATFIX, wire([serialised(message) for message in messages]))
    assert ours.is_fixed.tolist() == [False, True, False]


@pytest.mark.field_data
def test_the_drivers_own_fixes_are_what_rosbags_reads(field_data: Path) -> None:
    with open_bag(field_data / "novatel_oem7/bestpos_ros2_mcap/bestpos_ros2_mcap.mcap") as bag:
        for name in ("/gps/fix", "/gps/gps"):
            topic = next(known for known in bag.topics if known.name == name)
            messages = list(bag.messages(name))
            theirs = [typestore().deserialize_cdr(message.payload, topic.type) for message in messages]
            for schema in ("", topic.schema):
                ours = decode_gnss(topic.type, messages, schema)
                _check(ours, theirs, SAME)
                assert len(ours.stamps_ns) == 12
                assert ours.is_fixed.all()
                assert np.allclose(ours.latitude_deg, 51.15, atol=0.1)  # NovAtel, Calgary


@settings(max_examples=30)
@given(seed=seeds, picks=st.lists(st.integers(0, 2), max_size=9))
def test_camera_infos_are_kept_once_each(seed: int, picks: list[int]) -> None:
    generator = np.random.default_rng(seed)
    distinct = [random_message(INFO, generator) for _ in range(3)]
    for message, width in zip(distinct, (640, 1280, 1920), strict=True):
        message.width = width
    sent = wire([serialised(distinct[pick]) for pick in picks])
    ours = decode_camera_info(sent)
    assert [ours.infos[which].width_px for which in ours.which] == [(640, 1280, 1920)[pick] for pick in picks]
    assert len(ours.infos) == len(set(picks))
    for info, message in zip((ours.infos[which] for which in ours.which), read_by_rosbags(INFO, sent), strict=True):
        assert (info.frame_id, info.model, info.height_px) == (
            message.header.frame_id, message.distortion_model, message.height,
        )  # fmt: skip
        for mine, name in (("distortion", "d"), ("k", "k"), ("r", "r"), ("p", "p")):
            assert getattr(info, mine).tobytes() == np.asarray(getattr(message, name)).tobytes()
        assert info.binning == (message.binning_x, message.binning_y)
        roi = message.roi
        assert info.roi_px == (roi.x_offset, roi.y_offset, roi.width, roi.height)
        assert info.is_calibrated == (message.k[0] != 0)


WEEK_MS = 604_800_000


def _utc(week: int, milliseconds: int) -> datetime:
    return datetime.fromtimestamp(unix_ns(np.array([week]), np.array([milliseconds]))[0] / 1e9, UTC)


def test_gps_time_begins_in_1980_and_a_leap_second_exactly_at_midnight() -> None:
    assert _utc(0, 0) == datetime(1980, 1, 6, tzinfo=UTC)
    # 2017-01-01T00:00:00 UTC is GPS week 1930, second 18: the second before it is 23:59:60.
    assert _utc(1930, 18_000) == datetime(2017, 1, 1, tzinfo=UTC)
    assert _utc(1930, 16_000) == datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)


@pytest.mark.parametrize(
    ("day", "seconds"),
    [((2016, 12, 31), 17), ((2017, 1, 2), 18), ((2026, 7, 1), 18), ((1999, 6, 1), 13), ((1981, 6, 30), 0)],
)
def test_the_offset_is_that_of_the_day(day: tuple[int, int, int], seconds: int) -> None:
    noon_s = int(datetime(*day, 12, tzinfo=UTC).timestamp())
    assert leap_seconds(np.array([noon_s + seconds])).tolist() == [seconds]


@given(week=st.integers(1931, 4000), milliseconds=st.integers(0, WEEK_MS - 1))
def test_since_2017_it_is_the_plain_formula(week: int, milliseconds: int) -> None:
    expected = (315_964_800 + week * 604_800 - 18) * 10**9 + milliseconds * 10**6
    assert unix_ns(np.array([week], np.uint16), np.array([milliseconds], np.uint32)).tolist() == [expected]


@given(week=st.integers(0, 4000), milliseconds=st.integers(0, WEEK_MS - 2000))
def test_time_never_runs_backwards_except_within_a_leap_second(week: int, milliseconds: int) -> None:
    now, later = unix_ns(np.array([week, week]), np.array([milliseconds, milliseconds + 1001]))
    assert later > now
