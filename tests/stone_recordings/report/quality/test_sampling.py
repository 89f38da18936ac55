"""Samples are spread over the recording, bounded in number, and a message that lies costs only itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import MalformedBagError, MessageLayoutError
from stone_recordings.report.quality.sampling import (
    HEAVY,
    INSTANTS,
    LIGHT,
    LONGEST_KEPT_BYTES,
    TINY,
    Effort,
    SampledMessages,
    TopicSampling,
    sample,
)
from tests.stone_recordings.report.quality.recordings import ticks
from tests.stone_recordings.rigs import stamped, written
from tests.stone_recordings.writing import write_mcap

TOPIC = "/imu"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    stamps = ticks(40.0, 100.0)
    return written(folder / "run.mcap", [stamped(TOPIC, "sensor_msgs/msg/Imu", int(stamp), "imu") for stamp in stamps])


@pytest.mark.parametrize(("effort", "count"), [(HEAVY, 32), (LIGHT, 128), (TINY, INSTANTS)])
def test_the_samples_of_a_long_topic_are_bounded_and_evenly_spread(recording: Path, effort: Effort, count: int) -> None:
    seen: list[int] = []
    with open_bag(recording) as bag:
        topic = bag.topics[0]
        assert sample(bag, [TopicSampling(topic, lambda at_ns, _payload: seen.append(at_ns), effort)]) == ()
        span_ns = bag.end_ns - bag.start_ns
    assert len(seen) == count
    assert np.abs(np.diff(seen) - span_ns / count).max() <= 10_000_001  # one message's period


@given(count=st.integers(1, 9))
def test_every_message_of_a_short_topic_is_seen_once_and_in_order(tmp_path_factory, count):
    stamps = [int(stamp) for stamp in ticks(count / 10, 10.0)]
    path = tmp_path_factory.mktemp("short") / "run.mcap"
    written(path, [stamped(TOPIC, "sensor_msgs/msg/Imu", stamp, "imu") for stamp in stamps])
    seen: list[int] = []
    with open_bag(path) as bag:
        sample(bag, [TopicSampling(bag.topics[0], lambda at_ns, _payload: seen.append(at_ns), TINY)])
    assert seen == [stamp - stamps[0] for stamp in stamps]


def test_topics_are_looked_at_at_the_same_instants(recording: Path) -> None:
    order: list[str] = []
    with open_bag(recording) as bag:
        looks = [TopicSampling(bag.topics[0], lambda _at, _payload, who=who: order.append(who), HEAVY) for who in "ab"]
        sample(bag, looks)
    assert order == ["a", "b"] * 32


def test_messages_that_lie_are_counted_and_where_all_do_it_is_an_error(recording: Path) -> None:
    def refuse_odd(at_ns: int, _payload: memoryview) -> None:
        if at_ns // 10_000_000 % 2:
            raise MessageLayoutError("sensor_msgs/msg/Imu", "it lies")

    with open_bag(recording) as bag:
        (finding,) = sample(bag, [TopicSampling(bag.topics[0], refuse_odd, TINY)])
    assert (finding.code, finding.severity, finding.topic) == ("MSG-301", "warning", TOPIC)
    assert "of 512 sampled messages are left out: sensor_msgs/msg/Imu: it lies" in finding.message

    def refuse(_at_ns: int, _payload: memoryview) -> None:
        raise MessageLayoutError("x", "it lies")

    with open_bag(recording) as bag:
        (finding,) = sample(bag, [TopicSampling(bag.topics[0], refuse, HEAVY)])
    assert finding.severity == "error"
    assert finding.message.startswith("32 of 32")


@pytest.mark.parametrize("last_ns", [2**63 - 1, 2**63, 2**64 - 1])
def test_log_times_at_the_ends_of_what_a_clock_can_say_are_sampled_or_refused(tmp_path: Path, last_ns: int) -> None:
    usual = stamped(TOPIC, "sensor_msgs/msg/Imu", 0, "imu")
    messages = [replace(usual, log_time_ns=min(number * 7_000_000, last_ns)) for number in range(600)]
    path = write_mcap(tmp_path / "run.mcap", [*messages, replace(usual, log_time_ns=last_ns)])
    seen: list[int] = []
    try:
        with open_bag(path) as bag:
            sample(bag, [TopicSampling(bag.topics[0], lambda at_ns, _payload: seen.append(at_ns), TINY)])
    except MalformedBagError:
        assert last_ns >= 2**63
    else:
        assert seen == sorted(set(seen))
        assert 1 <= len(seen) <= INSTANTS


@pytest.mark.whole
@pytest.mark.parametrize(("frame_bytes", "reads"), [(3, INSTANTS), (LONGEST_KEPT_BYTES, 2 * INSTANTS)])
def test_small_messages_that_were_sampled_before_are_not_read_again(tmp_path, monkeypatch, frame_bytes, reads):
    frame = "f" * frame_bytes
    stamps = ticks(40.0, 100.0).tolist()
    path = written(tmp_path / "run.mcap", [stamped(TOPIC, "sensor_msgs/msg/Imu", int(at), frame) for at in stamps])
    seen: list[tuple[int, bytes]] = []
    asked: list[int] = []
    read = Bag.message
    monkeypatch.setattr(Bag, "message", lambda bag, topic, index: asked.append(index) or read(bag, topic, index))
    with open_bag(path) as bag:
        look = TopicSampling(bag.topics[0], lambda at_ns, payload: seen.append((at_ns, bytes(payload))), TINY)
        sampled = SampledMessages(bag)
        for _ in range(2):
            assert sample(bag, [look], sampled) == ()
    assert (len(asked), len(seen)) == (reads, 2 * INSTANTS)
    assert seen[:INSTANTS] == seen[INSTANTS:]
