"""Recordings by command: inspected, recovered, simulated; with poses of a file, with chosen topics and clocks."""

import json
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import typer
from PIL import Image
from rich.console import Console
from rosbags.highlevel import AnyReader
from typer.testing import Result

from services.domain.sequences import label_choices
from services.domain.sequences.label_choices import PROFILES
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate, write_calibration
from stone.labels.profiles import Profile
from stone_client.options import DEFAULT_PROFILE, LabelProfile
from stone_client.tables import clock_table
from stone_local.topic_choices import chosen_offsets
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.clocks.report import ClockReport, ImuLag, TopicClock
from testing.worlds.pose_files import tum_text
from tests.stone_client.participating import stone
from tests.stone_recordings import rigs
from tests.stone_recordings.report.quality import recordings
from tests.stone_recordings.report.quality.recordings import ticks
from tests.stone_recordings.rigs import PERIOD_NS, T0_NS, plain_sweep, written


def test_json_is_one_object_with_every_topic(bag: Path) -> None:
    result = stone("inspect", bag, "--json")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert record["duration_ns"] > 10**9
    lidar = next(topic for topic in record["topics"] if topic["role"] == "lidar")
    assert (lidar["type"], lidar["count"]) == ("sensor_msgs/msg/PointCloud2", 10)
    assert lidar["rate_hz"] == pytest.approx(10.0, abs=0.01)
    assert {"ins", "imu", "radar", "tf_static"} <= {topic["role"] for topic in record["topics"]}
    for finding in record["findings"]:
        assert set(finding) == {"code", "severity", "topic", "message"}


def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    for content in [
        b"<!doctype html><title>Sign in</title>",
        b"",
        b"\x89MCAP0\r\n",
        b"\x89MCAP0\r\n" + bytes(500),
        b"#ROSBAG V2.0\n",
    ]:
        (tmp_path / "run.mcap").write_bytes(content)
        result = stone("inspect", tmp_path / "run.mcap", "--json")
        assert result.exit_code == 1
        assert len(result.stderr.splitlines()) == 1
        assert json.loads(result.stdout)["findings"][0]["severity"] == "error"


def test_with_a_calibration_labelling_is_looked_ahead_to(bag: Path, tmp_path: Path) -> None:
    rig = calibration_path(bag)
    plain, checked = stone("inspect", bag, "--json"), stone("inspect", bag, "--json", "--calibration", str(rig))
    assert (plain.exit_code, checked.exit_code) == (0, 0)
    codes = [{found["code"] for found in json.loads(one.stdout)["findings"]} for one in (plain, checked)]
    assert codes[0] <= codes[1]
    rig_of_nothing = tmp_path / "other.yaml"
    rig_of_nothing.write_text("stone_calibration: 1\nname: none\n")
    refused = stone("inspect", bag, "--calibration", str(rig_of_nothing))
    assert refused.exit_code == 1


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "$HOME <b>.mcap"
    return written(path, recordings.clouds(ticks(2, 10)), recordings.solutions(ticks(2, 20), 56))


@pytest.mark.whole
def test_the_page_holds_the_score_and_the_pictures_and_json_the_numbers(drive: Path, tmp_path: Path) -> None:
    result = stone("inspect", drive, "--html", str(tmp_path / "out.html"), "--json")
    assert result.exit_code == 0, result.output
    quality = json.loads(result.stdout)["quality"]
    page = (tmp_path / "out.html").read_text("utf-8")
    assert f"Quality {quality['score']} of 100" in page
    assert page.count('<img src="data:image/png;base64,') == 2
    assert "$HOME &lt;b&gt;.mcap" in page
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]


def test_a_camera_that_cannot_be_read_is_named_and_labels_are_still_possible(tmp_path: Path) -> None:
    lies = [recordings.picture("/camera/front/image", int(stamp), b"no picture") for stamp in ticks(1, 10)]
    sound = recordings.clouds(ticks(2, 10)), recordings.solutions(ticks(2, 20), 56)
    path = written(tmp_path / "run.mcap", lies, *sound)
    assert stone("inspect", path).exit_code == 0
    result = stone("inspect", path, "--html", str(tmp_path / "out.html"))
    assert result.exit_code == 0
    assert "/camera/front/image: 10 of 10 sampled messages are left out" in result.stderr
    assert (tmp_path / "out.html").is_file()


@pytest.fixture
def cut(bag: Path, tmp_path: Path) -> Path:
    (tmp_path / "cut").mkdir()
    whole = bag.read_bytes()
    (tmp_path / "cut" / "run.mcap").write_bytes(whole[: len(whole) * 4 // 5])
    return tmp_path / "cut" / "run.mcap"


def test_a_cut_recording_is_refused_recovered_and_then_inspected(cut: Path, tmp_path: Path) -> None:
    out = tmp_path / "recovered.mcap"
    refused = stone("inspect", cut)
    assert refused.exit_code == 1
    assert "BAG-010" in refused.stderr
    recovered = stone("recover", cut, "-o", out)
    assert recovered.exit_code == 0
    assert recovered.stdout.strip() == str(out)
    assert recovered.stderr.startswith("warning: BAG-010: run.mcap was cut off at byte ")
    inspected = json.loads(stone("inspect", out, "--json").stdout)
    assert sum(topic["count"] for topic in inspected["topics"]) > 50
    assert "BAG-011" not in [finding["code"] for finding in inspected["findings"]]


def test_the_recording_itself_is_never_written_over(cut: Path) -> None:
    before = cut.read_bytes()
    result = stone("recover", cut, "-o", cut)
    assert result.exit_code == 1
    assert result.stderr.startswith("BAG-026: run.mcap is the original")
    assert cut.read_bytes() == before


@pytest.mark.whole
def test_pictures_are_of_the_asked_size_detail_and_light_and_so_is_the_calibration(tmp_path: Path) -> None:
    bag, truth = tmp_path / "run.mcap", tmp_path / "truth"
    cameras = ("--camera-width", "96", "--camera-detail", "full", "--illumination", "night")
    made = stone("simulate", bag, "--seconds", "0.3", "--channels", "4", "--columns", "24", "--truth", truth, *cameras)
    assert made.exit_code == 0, made.stderr
    options = json.loads((truth / "world.json").read_text("utf-8"))["options"]
    assert (options["camera_detail"], options["illumination"]) == ("full", "night")
    calibration, _ = read_calibration(calibration_path(bag))
    assert {mount.intrinsics.width_px for mount in calibration.mounts if mount.intrinsics} == {96}
    with AnyReader([bag]) as reader:
        links = [link for link in reader.connections if link.topic.endswith("/compressed")]
        pictures = [reader.deserialize(raw, link.msgtype).data for link, _, raw in reader.messages(links)]
    assert {Image.open(BytesIO(picture.tobytes())).size for picture in pictures} == {(96, 60)}


STAMPS_NS = T0_NS + np.arange(8) * PERIOD_NS


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    return written(tmp_path / "run.mcap", [plain_sweep(int(stamp)) for stamp in STAMPS_NS])


def test_inspect_takes_a_file_for_a_source_of_poses(plain: Path, tmp_path: Path) -> None:
    assert "TOP-103" in stone("inspect", plain).stderr
    poses = tmp_path / "poses.txt"
    poses.write_text(tum_text(STAMPS_NS, rigs.world_from_ego(STAMPS_NS)))
    told = stone("inspect", plain, "--poses", poses, "--poses-frame", "base_link")
    assert (told.exit_code, "TOP-103" in told.stderr, "SYN-5" in told.stderr) == (0, False, False)


def test_a_calibration_is_checked_with_the_poses_of_a_file(plain: Path, tmp_path: Path) -> None:
    calibration, poses = tmp_path / "rig.yaml", tmp_path / "poses.txt"
    write_calibration(rigs.calibration(), calibration)
    check = ("calibration", "check", calibration, "--bag", plain, "--poses", poses, "--poses-frame")
    poses.write_text(tum_text(STAMPS_NS, rigs.world_from_ego(STAMPS_NS)))
    assert "SYN-5" not in stone(*check, "base_link").stderr
    assert "SYN-517: poses.txt: unknown frame 'chassis'" in stone(*check, "chassis").stderr


def test_a_file_and_a_topic_are_not_taken_together(plain: Path, tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("")
    calibration = tmp_path / "rig.yaml"
    calibration.write_text("")
    label = ("label", plain, "--calibration", calibration, "-o", tmp_path / "labels")
    refused = stone(*label, "--poses", poses, "--odometry", "/odom")
    assert refused.exit_code == 2
    assert "--poses" in refused.stderr


FRONT = "/camera/front/image/compressed"


@pytest.fixture(scope="module")
def rig_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bag = tmp_path_factory.mktemp("rig_drive") / "run.mcap"
    simulate(bag, SimulateOptions(seconds=0.5, channels=8, columns=48, camera_width_px=32, world_width_m=30.0))
    return bag


def channels(result: Result) -> dict[str, str]:
    found: dict[str, str] = json.loads(result.stdout)["channels"]
    return found


def test_a_choice_is_saved_and_used_for_the_next_recording(rig_drive: Path, tmp_path: Path) -> None:
    saved = tmp_path / "rover.yaml"
    first = stone("inspect", rig_drive, "--topic", f"CAM_BACK={FRONT}", "--save-topics", saved, "--json")
    assert channels(first)["CAM_BACK"] == FRONT
    assert "CAM_FRONT" not in channels(first)
    assert channels(stone("inspect", rig_drive, "--topics", saved, "--json")) == channels(first)
    mended = stone("inspect", rig_drive, "--topics", saved, "--topic", f"CAM_FRONT={FRONT}", "--json")
    assert channels(mended)["CAM_FRONT"] == FRONT


def test_labels_are_refused_a_topic_that_cannot_give_poses(rig_drive: Path, tmp_path: Path) -> None:
    rig = rig_drive.with_name("run.calibration.yaml")
    asked = ("label", rig_drive, "--calibration", rig, "-o", tmp_path / "labels", "--topic", "pose=/imu/data")
    result = stone(*asked)
    assert result.exit_code == 1
    assert "TOP-104" in result.stderr
    assert "/imu/data" in result.stderr


def test_the_commands_profiles_are_those_of_the_platform() -> None:
    assert tuple(LabelProfile) == PROFILES
    assert DEFAULT_PROFILE == label_choices.DEFAULT_PROFILE
    assert set(get_args(Profile)) == set(PROFILES)


def test_a_parameter_reaches_the_labels_and_the_held_out_track_is_told(tmp_path: Path) -> None:
    bag, out = tmp_path / "run.mcap", tmp_path / "labels"
    simulate(bag, SimulateOptions(seconds=8.0, seed=3, channels=16, columns=180, cameras=False, lidar_hz=2))
    asked = ("label", bag, "--calibration", calibration_path(bag), "-o", out, "--workers", "1", "--parameter")
    done = stone(*asked, "reference.outlier_ratio=0.25")
    assert done.exit_code == 0, done.stderr
    report = json.loads((out / "report.json").read_text())
    assert report["parameters"]["profile"] == label_choices.DEFAULT_PROFILE
    assert report["parameters"]["reference"]["outlier_ratio"] == 0.25
    held_out = report["held_out"]
    share = f"{100 * held_out['recall']:.1f} % of {held_out['judged_m']:.0f} m that the robot drove over"
    assert f"Held-out track: {share} is T or P in labels made from the other half" in done.stdout
    assert done.stdout.count("Held-out track") == 1


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        (["reference.alpha=0.9"], "the value must be between 0.0001 and 0.5"),
        (["terrain.neighbours=20.5"], "expected a whole number from 8 to 64"),
        (["tiling.cube_cells=8"], "the available parameters are selection.min_range_m"),
        (["reference.outlier_ratio=0.25", "--profile", "paper"], "profiles field and local can"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_before_anything_is_read(
    bag: Path, tmp_path: Path, choices: list[str], words: str
) -> None:
    label = ("label", bag, "--calibration", calibration_path(bag), "-o", tmp_path / "labels")
    refused = stone(*label, "--parameter", *choices)
    assert refused.exit_code == 1
    assert refused.stderr.startswith("bad_parameter: ")
    assert words in refused.stderr
    assert not (tmp_path / "labels").exists()


def test_offsets_are_read_to_the_nanosecond_in_every_unit() -> None:
    assert chosen_offsets(["lidar=-18s", "pose=12.5ms"]) == {"lidar": -18 * 10**9, "pose": 12_500_000}
    assert chosen_offsets(["lidar=+0.000000001s"]) == {"lidar": 1}
    assert chosen_offsets(["pose=7us", "pose=3ns"]) == {"pose": 3}
    assert chosen_offsets([]) == {}


@pytest.mark.parametrize("choice", ["lidar", "lidar=18", "camera=1s", "lidar=1e3s", "lidar=1m", "lidar=nans", "=1s"])
def test_what_is_no_offset_is_refused_with_how_to_write_one(choice: str) -> None:
    with pytest.raises(typer.BadParameter, match=r"write lidar=-18s or pose=12\.5ms"):
        chosen_offsets([choice])


def test_more_than_a_lifetime_is_a_slip_of_the_unit_and_years_are_exact() -> None:
    with pytest.raises(typer.BadParameter, match="is the unit right"):
        chosen_offsets(["lidar=2300000000s"])
    assert chosen_offsets(["lidar=+110054594.750000001s"]) == {"lidar": 110_054_594_750_000_001}
    assert chosen_offsets(["pose=-1699999331710000003ns"]) == {"pose": -1_699_999_331_710_000_003}


def _shown(report: ClockReport) -> str:
    console = Console(width=120, file=StringIO())
    with console.capture() as shown:
        console.print(clock_table(report.as_record()))
    return shown.get()


def _clock(topic: str, **facts: Any) -> TopicClock:
    return TopicClock(topic, facts.pop("role", "imu"), 10, 10.0, facts.pop("stamp_source", "sensor"), **facts)


def test_names_of_topics_are_no_markup() -> None:
    shown = _shown(ClockReport((_clock("/[bold]x[/bold]"),), ImuLag("/[red]i", "/[/red]r", 0, 0, 1.0)))
    assert "/[bold]x[/bold]" in shown
    assert "/[red]i" in shown
