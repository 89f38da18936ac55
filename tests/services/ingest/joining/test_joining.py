"""Recordings of one run joined: offsets that are shared, given and measured, and what is not joined.

The measured ones cost some seconds; they catch alone an offset with the wrong sign, and one that is taken where nothing
tells it.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from services.ingest.joining.clocks import JoinRequest, join_recordings
from services.ingest.pipeline import SynchroniseOptions
from simulator.pipeline import calibration_path
from stone_files.joined_file import GIVEN, GYRO, RADARS, REFERENCE, SAME_MESSAGES, SAME_TOPICS, JoinedMember
from stone_recordings.bags.bag import open_bag
from stone_recordings.joining.joined_recording import write_joined
from testing.refusals import refused_as
from testing.worlds.drives import drive
from testing.worlds.recording_parts import RecordingPart, split_into
from testing.worlds.runs import SMALL

AHEAD_NS = 80_000_000
LIMIT_NS = 2_000_000
Holds = Callable[[str, int], bool]


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, SMALL)


def of(*words: str) -> Holds:
    return lambda topic, _time: any(word in topic for word in words)


def everything(_topic: str, _time: int) -> bool:
    return True


NAV = RecordingPart("nav.mcap", of("lidar", "novatel", "tf", "imu"))
RADAR = RecordingPart("radar.bag", of("radar"), AHEAD_NS)


def join(source: Path, folder: Path, *parts: RecordingPart, **given_ns: int) -> tuple[JoinedMember, ...]:
    paths = split_into(source, folder, parts)
    named = {f"{stem}{path.suffix}": ns for stem, ns in given_ns.items() for path in paths if path.stem == stem}
    return join_recordings(JoinRequest(paths, calibration_path(source), named)).members


def test_what_is_given_is_taken(short: Path, tmp_path: Path) -> None:
    nav, radar = join(short, tmp_path, RADAR, NAV, radar=-AHEAD_NS)
    assert nav == JoinedMember("nav.mcap", 0, None, (REFERENCE,))
    assert radar == JoinedMember("radar.bag", -AHEAD_NS, None, (GIVEN,))


def test_the_order_of_the_names_does_not_matter(short: Path, tmp_path: Path) -> None:
    paths = split_into(short, tmp_path, (NAV, RADAR))
    one, two = (join_recordings(JoinRequest(order, None, {"radar.bag": 5})) for order in (paths, paths[::-1]))
    assert one == two
    assert one.name == "nav"


def test_messages_that_somebody_moved_tell_the_offset_exactly(short: Path, tmp_path: Path) -> None:
    _nav, radar = join(
        short,
        tmp_path,
        RecordingPart("nav.mcap", everything),
        RecordingPart("radar.mcap", of("radar", "imu"), AHEAD_NS),
    )
    assert (radar.offset_ns, radar.sigma_ns, radar.known_by) == (-AHEAD_NS, 0, (SAME_MESSAGES,))
    with open_bag(short) as bag:
        counts = {topic.name: topic.count for topic in bag.topics if "radar" in topic.name or "imu" in topic.name}
    assert radar.count_left_out() == counts


def test_a_recorder_that_logs_on_another_clock_is_told_by_what_both_log(short: Path, tmp_path: Path) -> None:
    """Its own sensors are stamped by its host, the IMU by who publishes it: those stamps stay."""
    paths = split_into(
        short,
        tmp_path,
        (NAV, RecordingPart("host.mcap", of("radar"), AHEAD_NS), RecordingPart("imu.mcap", of("imu"))),
    )
    with open_bag(paths[2]) as bag:
        kept = [(message.log_time_ns, bytes(message.payload)) for message in bag.messages("/imu/data")]
    added(paths[1], "/imu/data", [(time_ns + AHEAD_NS, data) for time_ns, data in kept])
    _nav, host = join_recordings(JoinRequest(paths[:2])).members
    assert (host.offset_ns, host.known_by, host.kept_topics) == (-AHEAD_NS, (SAME_MESSAGES,), ("/imu/data",))
    assert host.count_left_out() == {"/imu/data": len(kept)}


def added(path: Path, topic: str, messages: list[tuple[int, bytes]]) -> None:
    """Write the recording anew with messages of an IMU in it."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    from stone_recordings.messages.types.registry import message_definition

    source = path.read_bytes()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", library="test")
        channels: dict[str, int] = {}

        def channel_of(name: str, kind: str) -> int:
            if name not in channels:
                schema = writer.register_schema(kind, "ros2msg", message_definition(kind).encode())
                channels[name] = writer.register_channel(name, "cdr", schema)
            return channels[name]

        import io

        for schema, channel, message in make_reader(io.BytesIO(source)).iter_messages():
            if schema is not None:
                writer.add_message(channel_of(channel.topic, schema.name), message.log_time, message.data, 0)
        for time_ns, data in messages:
            writer.add_message(channel_of(topic, "sensor_msgs/msg/Imu"), time_ns, data, 0)
        writer.finish()  # type: ignore[no-untyped-call]


def test_a_run_that_was_cut_goes_on(short: Path, tmp_path: Path) -> None:
    """An overlap of both parts is had once."""
    with open_bag(short) as bag:
        middle_ns = (bag.start_ns + bag.end_ns) // 2
        whole = {topic.name: topic.count for topic in bag.topics}
    parts = (
        RecordingPart("one.mcap", lambda _topic, time: time < middle_ns),
        RecordingPart("two.mcap", lambda _topic, time: time >= middle_ns),
        RecordingPart("three.mcap", lambda _topic, time: time >= middle_ns - 100_000_000),
    )
    one, two = join(short, tmp_path, *parts[:2])
    assert (one.known_by, two.known_by, two.offset_ns) == ((REFERENCE,), (SAME_TOPICS,), 0)
    paths = split_into(short, tmp_path, parts[::2])
    overlapping = join_recordings(JoinRequest(paths))
    assert overlapping.members[1].known_by == (SAME_MESSAGES,)
    folder = tmp_path / "joined"
    folder.mkdir()
    write_joined(overlapping, folder)
    with open_bag(folder) as bag:
        assert {topic.name: topic.count for topic in bag.topics} == whole


@pytest.mark.whole
def test_the_clocks_of_radars_and_of_an_imu_are_measured(long: Path, tmp_path: Path) -> None:
    nav, imu, radar = join(
        long,
        tmp_path,
        RecordingPart("nav.mcap", of("lidar", "novatel", "tf")),
        RecordingPart("imu.mcap", of("imu"), 3 * AHEAD_NS),
        RecordingPart("radar.bag", of("radar"), -AHEAD_NS),
    )
    assert nav.known_by == (REFERENCE,)
    assert (imu.known_by, radar.known_by) == ((GYRO,), (RADARS,))
    for member, ahead_ns in ((imu, 3 * AHEAD_NS), (radar, -AHEAD_NS)):
        assert abs(member.offset_ns + ahead_ns) < LIMIT_NS
        assert 0 < (member.sigma_ns or 0) < LIMIT_NS
    assert abs(imu.offset_ns + 3 * AHEAD_NS) < 4 * (imu.sigma_ns or 0)


@pytest.mark.whole
def test_the_parts_of_a_recording_that_was_cut_are_of_one_clock(long: Path, tmp_path: Path) -> None:
    with open_bag(long) as bag:
        middle_ns = (bag.start_ns + bag.end_ns) // 2
    _nav, one, two = join(
        long,
        tmp_path,
        NAV,
        RecordingPart("radar_0.mcap", lambda topic, time: "radar" in topic and time < middle_ns, AHEAD_NS),
        RecordingPart("radar_1.mcap", lambda topic, time: "radar" in topic and time >= middle_ns, AHEAD_NS),
    )
    assert one.offset_ns == two.offset_ns
    assert abs(one.offset_ns + AHEAD_NS) < LIMIT_NS


def test_poses_in_another_recording_are_found(long: Path, tmp_path: Path) -> None:
    """They bear GPS time, which no offset moves: the clock of their recorder is told by the gyro beside them."""
    nav, ins = join(
        long,
        tmp_path,
        RecordingPart("lidar.mcap", of("lidar", "tf_static")),
        RecordingPart("ins.mcap", of("novatel", "imu"), AHEAD_NS),
    )
    assert (nav.name, ins.known_by) == ("lidar.mcap", (GYRO,))
    assert abs(ins.offset_ns + AHEAD_NS) < LIMIT_NS


@pytest.mark.whole
def test_sensors_that_contradict_each_other_are_refused(long: Path, tmp_path: Path) -> None:
    paths = split_into(
        long,
        tmp_path,
        (
            RecordingPart("nav.mcap", of("lidar", "novatel", "tf")),
            RecordingPart("both.mcap", of("radar"), 2 * AHEAD_NS),
            RecordingPart("imu.mcap", of("imu")),
        ),
    )
    with open_bag(paths[2]) as bag:
        added(
            paths[1],
            "/imu/data",
            [(message.log_time_ns, bytes(message.payload)) for message in bag.messages("/imu/data")],
        )
    with refused_as("SYN-524", match=r"--clock-offset both\.mcap"):
        join_recordings(JoinRequest(paths[:2], calibration_path(long)))


def test_a_recording_whose_sensors_tell_no_time_is_refused(short: Path, tmp_path: Path) -> None:
    """A second is too short to tell one lag from another."""
    with refused_as("SYN-523", match=r"--clock-offset radar\.bag=SECONDS"):
        join(short, tmp_path, NAV, RADAR)
    paths = split_into(short, tmp_path, (NAV, RADAR))
    with refused_as("SYN-523", match="no calibration"):
        join_recordings(JoinRequest(paths))


def test_a_recording_of_another_time_is_refused(short: Path, tmp_path: Path) -> None:
    for apart_ns, when in ((10**11, "after the end"), (-(10**11), "before the beginning")):
        with refused_as("SYN-525", match=when):
            join(short, tmp_path, NAV, RADAR, radar=apart_ns)


def test_recordings_without_a_lidar_are_refused(short: Path, tmp_path: Path) -> None:
    with refused_as("TOP-101"):
        join(short, tmp_path, RecordingPart("imu.mcap", of("imu")), RADAR)


def test_a_topic_of_two_types_is_refused(short: Path, tmp_path: Path) -> None:
    paths = split_into(short, tmp_path, (NAV, RADAR))
    other = tmp_path / "other.mcap"
    other.write_bytes(paths[0].read_bytes())
    added(other, "/radar/front/detections", [(1, b"\0\1\0\0")])
    with refused_as("BAG-041"):
        join_recordings(JoinRequest((*paths, other)))


@pytest.mark.whole
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda paths: JoinRequest(paths[:1]), "1 recordings"),
        (lambda paths: JoinRequest((paths[0], paths[0])), "the same name"),
        (lambda paths: JoinRequest(paths, given_ns={"other.bag": 1}), "not one of"),
        (lambda paths: JoinRequest(paths, given_ns={"nav.mcap": 1}), "contains the LiDAR"),
        (lambda paths: JoinRequest((*paths, paths[0].parent / "joined")), "already a joined recording"),
    ],
)
def test_what_cannot_be_a_run_is_refused(
    short: Path, tmp_path: Path, change: Callable[[tuple[Path, ...]], JoinRequest], why: str
) -> None:
    paths = split_into(short, tmp_path, (NAV, RADAR))
    (tmp_path / "joined").mkdir()
    write_joined(join_recordings(JoinRequest(paths, given_ns={"radar.bag": 0})), tmp_path / "joined")
    with refused_as("SYN-526", match=why):
        join_recordings(change(paths))


def test_the_topic_that_is_asked_for_says_who_is_the_reference(short: Path, tmp_path: Path) -> None:
    paths = split_into(short, tmp_path, (NAV, RADAR))
    options = SynchroniseOptions(lidar_topic="/radar/front/detections")
    assert join_recordings(JoinRequest(paths, None, {"nav.mcap": 0}, options)).name == "radar"
