"""The clock report gives back the clocks that a recording was made with."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import ByteOrderError, MessageLayoutError
from stone_recordings.bags.message_store import Topic
from stone_recordings.clocks.measurement import OWN_TIME_BYTES, POSE_BYTES, has_own_time, kept_bytes, own_times
from stone_recordings.clocks.report import TopicClock
from stone_recordings.messages.types.registry import message_definition
from stone_recordings.poses.ins_poses import track_from_ins
from stone_recordings.report.inspection import MOST_TOPICS, Inspection, inspection_record
from stone_recordings.report.quality.section_clocks import clocks_section
from stone_recordings.report.scan import MOST_KEPT, KeptMessage, scan_of
from tests.stone_recordings import rigs
from tests.stone_recordings.clocks.streams import (
    IMAGE,
    IMU,
    INSPVAX,
    MS,
    RADAR,
    Stamps,
    clouds,
    every,
    inspected,
    radar_lists,
    sentence,
    solutions,
    stream,
    timing_codes,
)
from tests.stone_recordings.writing import Recorded, write_mcap

CLOUDS = every(100 * MS, 30)


def _lidar() -> list[Recorded]:
    return clouds(CLOUDS, CLOUDS + 105 * MS)


def _clock(inspection: Inspection, topic: str) -> TopicClock:
    return next(clock for clock in inspection.clocks.topics if clock.topic == topic)


def test_offset_drift_and_jitter_are_those_of_the_recording(tmp_path: Path) -> None:
    times_ns = every(10 * MS, 1000)
    stamps_ns = times_ns + ((times_ns - times_ns[0]) * 80e-6).astype(np.int64)
    jitter_ns = np.random.default_rng(0).normal(0, 150_000, 1000).astype(np.int64)
    clock = _clock(inspected(tmp_path, _lidar(), stream("/imu", IMU, stamps_ns, times_ns + 3 * MS + jitter_ns)), "/imu")
    assert (clock.role, clock.count, clock.stamp_source) == ("imu", 1000, "sensor")
    assert clock.rate_hz == pytest.approx(100, rel=1e-3)
    assert clock.offset_ns == pytest.approx(3 * MS - 5_000 * 80, abs=30_000)
    assert clock.drift_ppm == pytest.approx(80, abs=6)
    assert clock.jitter_ns == pytest.approx(150_000, rel=0.1)


def test_a_receivers_stamps_are_the_hosts_where_they_scatter_and_else_its_own(tmp_path: Path) -> None:
    times_ns = every(50 * MS, 100)
    late_ns = np.random.default_rng(0).integers(0, 20 * MS, 100)
    clock = _clock(inspected(tmp_path, _lidar(), solutions("/ins", times_ns, late_ns)), "/ins")
    assert clock.stamp_source == "host"
    assert clock.own_offset_ns == pytest.approx(10 * MS, abs=2 * MS)
    assert clock.own_jitter_ns == pytest.approx(7.4 * MS, rel=0.25)  # of an even spread of 20 ms
    clock = _clock(inspected(tmp_path, _lidar(), solutions("/ins", times_ns, np.full(100, 4 * MS))), "/ins")
    assert (clock.stamp_source, clock.own_offset_ns, clock.own_jitter_ns) == ("sensor", 4 * MS, 0)


def test_a_radars_own_time_is_read_and_its_driver_found_out(tmp_path: Path) -> None:
    own_ns = every(50 * MS, 60)
    late_ns = np.random.default_rng(1).integers(2 * MS, 9 * MS, 60)
    inspection = inspected(tmp_path, _lidar(), radar_lists("/radar", own_ns + late_ns, own_ns))
    clock = _clock(inspection, "/radar")
    assert (clock.role, clock.stamp_source) == ("radar", "host")
    assert clock.own_offset_ns == round(float(np.median(late_ns)))
    assert timing_codes(inspection) == [("TIM-201", "/radar")]


def test_stamps_that_follow_their_publishing_are_the_hosts(tmp_path: Path) -> None:
    """No time of the sensor's own tells so, only that they are as irregular as the record times, and as late."""
    generator = np.random.default_rng(2)
    stamps_ns = np.sort(every(50 * MS, 100) + generator.integers(0, 12 * MS, 100))
    host = stream("/camera/a", IMAGE, stamps_ns, stamps_ns + 300_000 + generator.integers(0, 100_000, 100))
    sensor = stream("/camera/b", IMAGE, every(50 * MS, 100), stamps_ns + 30 * MS)
    inspection = inspected(tmp_path, _lidar(), host, sensor)
    assert _clock(inspection, "/camera/a").stamp_source == "host"
    assert _clock(inspection, "/camera/b").stamp_source == "sensor"
    assert timing_codes(inspection) == [("TIM-201", "/camera/a")]


def test_gaps_steps_back_and_repeats_are_counted_and_the_recorder_times_what_has_no_stamps(tmp_path: Path) -> None:
    stamps_ns = np.delete(every(10 * MS, 100), [50, 51, 52])
    stamps_ns[20] = stamps_ns[19]
    stamps_ns[30] -= 25 * MS
    times_ns = np.delete(every(10 * MS, 100), [50, 51, 52])
    clock = _clock(inspected(tmp_path, _lidar(), stream("/imu", IMU, stamps_ns, times_ns)), "/imu")
    assert (clock.gaps, clock.steps_back, clock.worst_step_back_ns, clock.repeats) == (1, 1, 15 * MS, 1)
    times_ns = every(10 * MS, 20)
    inspection = inspected(tmp_path, _lidar(), stream("/imu", IMU, np.zeros(20, np.int64), times_ns))
    clock = _clock(inspection, "/imu")
    assert (clock.stamp_source, clock.offset_ns, clock.drift_ppm, clock.jitter_ns) == ("recorder", None, None, None)
    assert clock.rate_hz == pytest.approx(100)
    assert timing_codes(inspection) == [("TIM-211", "/imu")]


def test_the_record_of_a_report_is_json_and_bounded(tmp_path: Path) -> None:
    inspection = inspected(tmp_path, _lidar(), solutions("/ins", every(50 * MS, 60), np.full(60, MS)))
    record = inspection_record(inspection)["clocks"]
    assert json.loads(json.dumps(record)) == json.loads(json.dumps(inspection.clocks.as_record()))
    assert [topic["topic"] for topic in record["topics"]] == ["/ins", "/lidar"]
    assert record["imu_lag"] is None
    assert len(inspection_record(_with_topics(inspection, MOST_TOPICS + 5))["clocks"]["topics"]) == MOST_TOPICS


def _with_topics(inspection: Inspection, count: int) -> Inspection:
    clock = inspection.clocks.topics[0]
    clocks = replace(inspection.clocks, topics=tuple(replace(clock, topic=f"/{row}" * 200) for row in range(count)))
    return replace(inspection, clocks=clocks)


def test_of_a_long_recording_the_middle_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Own times are measured on it, and on nothing else: the receiver stamps late at both ends only."""
    assert MOST_KEPT == 36_000
    monkeypatch.setattr("stone_recordings.report.scan.MOST_KEPT", 40)
    late_ns = np.full(100, MS)
    late_ns[:30] = late_ns[70:] = np.random.default_rng(0).integers(0, 20 * MS, 30)
    clock = _clock(inspected(tmp_path, _lidar(), solutions("/ins", every(50 * MS, 100), late_ns)), "/ins")
    assert (clock.count, clock.own_offset_ns, clock.own_jitter_ns) == (100, MS, 0)


def test_what_is_kept_of_all_topics_together_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two receivers share the room of one, and each keeps its middle."""
    monkeypatch.setattr("stone_recordings.report.scan.MOST_KEPT_BYTES", 2 * 40 * POSE_BYTES)
    times_ns = every(50 * MS, 100)
    path = write_mcap(tmp_path / "run.mcap", _solutions("/a", times_ns) + _solutions("/b", times_ns))
    with open_bag(path) as bag:
        scan = scan_of(bag, kept_bytes)
    assert {name: len(kept) for name, kept in scan.kept.items()} == {"/a": 40, "/b": 40}
    assert scan.kept_from == {"/a": 30, "/b": 30}
    assert scan.stamps_ns["/a"].tolist() == (times_ns + MS).tolist()


def _solutions(topic: str, times_ns: Stamps) -> list[Recorded]:
    return solutions(topic, times_ns, np.full(len(times_ns), MS))


def _topic(type_name: str) -> Topic:
    return Topic("/topic", type_name, 1, message_definition(type_name))


def _kept(messages: list[Recorded]) -> list[KeptMessage]:
    return [KeptMessage(memoryview(message.payload[:OWN_TIME_BYTES])) for message in messages]


@pytest.mark.parametrize("name", ["BESTPOS", "INSPVA", "INSPVAX"])
def test_every_log_of_the_receiver_carries_its_time(name: str) -> None:
    assert has_own_time(_topic(f"novatel_oem7_msgs/msg/{name}"))


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"])
def test_standard_types_carry_the_headers_time_alone(name: str) -> None:
    assert not has_own_time(_topic(name))


def test_gps_time_is_utc_again_and_a_radars_counts_where_it_was_synchronised() -> None:
    times_ns = every(50 * MS, 20)
    found = own_times(_topic(INSPVAX), _kept(solutions("/topic", times_ns, np.arange(20) * MS)))
    assert found.own_ns.tolist() == times_ns.tolist()
    assert found.late_ns.tolist() == (np.arange(20) * MS).tolist()
    assert found.total == 20
    stamps_ns = every(50 * MS, 4)
    messages = [
        *radar_lists("/topic", stamps_ns, stamps_ns - 7),
        *radar_lists("/topic", stamps_ns, stamps_ns, status=3),
    ]
    found = own_times(_topic(RADAR), _kept(messages))
    assert found.late_ns.tolist() == [7] * 4
    assert found.total == 8
    assert own_times(_topic(INSPVAX), []).late_ns.tolist() == []


@settings(max_examples=100)
@given(
    type_name=st.sampled_from([INSPVAX, RADAR]),
    cut=st.integers(0, 120),
    place=st.integers(0, 80),
    garbage=st.binary(min_size=1, max_size=8),
)
def test_garbage_is_read_or_refused_by_code(type_name: str, cut: int, place: int, garbage: bytes) -> None:
    whole = {INSPVAX: _INSPVAX, RADAR: _LIST}[type_name]
    damaged = (whole[:place] + garbage + whole[place + len(garbage) :])[:cut]
    try:
        found = own_times(_topic(type_name), [KeptMessage(memoryview(damaged))])
    except (MessageLayoutError, ByteOrderError):
        return
    assert len(found.late_ns) <= 1


_INSPVAX = solutions("/topic", every(MS, 1), np.zeros(1, np.int64))[0].payload
_LIST = radar_lists("/topic", every(MS, 1), every(MS, 1))[0].payload


TIMES_NS = every(50 * MS, 200)
ALIGNING = 80
"""So many of the messages come before the receiver's solution is aligned: their stamps count, their poses do not."""


def test_the_same_jitter_is_said_wherever_it_is_said(tmp_path: Path) -> None:
    lidar = clouds(every(100 * MS, 30), every(100 * MS, 30) + 105 * MS)
    aligning = rigs.ins_messages(TIMES_NS[:ALIGNING], seed=1, ins_status=1)
    inspection = inspected(tmp_path, lidar, aligning, rigs.ins_messages(TIMES_NS[ALIGNING:], seed=2))
    clock = next(clock for clock in inspection.clocks.topics if clock.topic == rigs.INS_TOPIC)
    assert (clock.own_jitter_ns, clock.stated_against) == (clock.stated_jitter_ns, "sensor time")
    shown = f"{(clock.stated_jitter_ns or 0) / 1e6:.2f}"
    assert 1.0 < float(shown) < 2.0
    found = sentence(inspection, "TIM-201", rigs.INS_TOPIC)
    assert f"jitter {shown} ms" in found
    assert _said_by_synchronisation(tmp_path / "run.mcap") == found
    section = clocks_section(inspection.clocks)
    assert section is not None
    assert section.table is not None
    assert shown in str(section.table.rows)


def _said_by_synchronisation(path: Path) -> str:
    with open_bag(path) as bag:
        track = track_from_ins(bag.messages(rigs.INS_TOPIC), rigs.INS_TOPIC, rigs.calibration(), None)
    return next(one.message for one in track.findings if one.code == "TIM-201")
