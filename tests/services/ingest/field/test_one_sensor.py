"""Sensors that cannot be read cost themselves: labels are those without them, and every export is written."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.registry import EXPORTERS
from services.labeler.exports.source import folder_source, read_report
from stone_datasets.reading import check_dataset
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect_in
from stone_recordings.report.previews.pictures import previews_of
from stone_recordings.report.quality.report import quality_of
from stone_recordings.sync.samples import checked_samples
from testing.worlds.field.drive import BareMessage, FieldDrive, FieldTopic
from testing.worlds.field.outcome import FieldOutcome, labelled_frames, outcome_of

pytestmark = pytest.mark.whole

SWEEPS = 8
WIDTH_PX, HEIGHT_PX = 64, 48
IMAGE, PACKED, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2"
SIDES = ("a", "b", "c", "d", "e")  # a side of the robot in the name would be compared with the mount
RADARS = ("front", "left", "right")
SOUND = "/cam_sound/image"
CAMERA_IN_RIG = (
    "{kind: camera, frame_id: %s, lidar_from_sensor: {translation_m: [0.2, 0, -0.1], "
    "rotation_wxyz: [0.5, -0.5, 0.5, -0.5]}, intrinsics: {model: plumb_bob, width_px: 64, height_px: 48, fx_px: 40, "
    "fy_px: 40, cx_px: 32, cy_px: 24, distortion: [0, 0, 0, 0, 0]}}"
)
RADAR_IN_RIG = (
    "{kind: radar, frame_id: %s, lidar_from_sensor: {translation_m: [0.3, 0, -0.3], rotation_wxyz: [1, 0, 0, 0]}}"
)
FRAMES = {
    **{f"cam_{side}": CAMERA_IN_RIG for side in (*SIDES, "sound")},
    **{f"radar_{side}": RADAR_IN_RIG for side in RADARS},
}
SENSORS = "{" + ", ".join(f"{frame.upper()}: {form % frame}" for frame, form in FRAMES.items()) + "}"
RADAR_POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("v", "f4"), ("rcs", "f4")])
Message = Callable[[FieldDrive, float, str], Any]  # of a drive, at a time, in a frame


def encoded(t: float, kind: str) -> bytes:
    file = BytesIO()
    pixels = np.random.default_rng(round(t * 10) + 9).integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, kind)
    return file.getvalue()


def raw(encoding: str = "rgb8", step: int = 3 * WIDTH_PX, size: tuple[int, int] = (HEIGHT_PX, WIDTH_PX)) -> Message:
    def message(drive: FieldDrive, t: float, frame: str) -> Any:
        data = np.full(size[0] * step, 90, np.uint8)
        return drive.of(IMAGE, drive.header(t + 0.02, frame), *size, encoding, 0, step, data)

    return message


def packed(of: Callable[[float], bytes], text: str = "jpeg") -> Message:
    def message(drive: FieldDrive, t: float, frame: str) -> Any:
        data = np.frombuffer(of(t), np.uint8)
        return drive.of(PACKED, drive.header(t + 0.02, frame), text, data)

    return message


def short_jpeg(t: float) -> bytes:
    whole = encoded(t, "JPEG")
    return whole[: whole.index(b"\xff\xda") + 20]


def bare(kind: str, content: bytes) -> Message:
    return lambda _drive, _t, _frame: BareMessage(kind, content)


def at_third(broken: Message, sound: Message) -> Message:
    return lambda drive, t, frame: (broken if round(t * 10) == 3 else sound)(drive, t, frame)


def radar_cloud(record: np.dtype[Any] = RADAR_POINT, count: int = 30, **other: Any) -> Message:
    def message(drive: FieldDrive, t: float, frame: str) -> Any:
        points = np.zeros(count, record)
        for number, name in enumerate(name for name in ("x", "y", "z") if name in (record.names or ())):
            points[name] = np.arange(count) % 7 + 2 + number
        return drive.cloud(t, points, frame, **other)

    return message


def radar_scan(drive: FieldDrive, t: float, frame: str) -> Any:
    one = drive.of("radar_msgs/msg/RadarReturn", 9.0, 0.1, 0.0, 1.0, 12.0)
    return drive.of("radar_msgs/msg/RadarScan", drive.header(t, frame), [one] * 9)


def cut_scan(drive: FieldDrive, t: float, frame: str) -> Any:
    whole = drive.store.serialize_cdr(radar_scan(drive, t, frame), "radar_msgs/msg/RadarScan")
    return BareMessage("radar_msgs/msg/RadarScan", bytes(whole)[:-30])


JPEG = packed(lambda t: encoded(t, "JPEG"))
INTEGERS = np.dtype([("x", "i4"), ("y", "i4"), ("z", "i4"), ("rcs", "f4")])
LETTERS = np.dtype([("a", "f4"), ("rcs", "f4")])


@dataclass(frozen=True)
class Broken:
    """A sensor whose messages cannot be read, all or one of them, and a word of its finding ("" for no finding)."""

    message: Message
    word: str


@dataclass(frozen=True)
class BrokenRig:
    """A recording of many broken sensors: cameras and radars of the rig in order, and topics beside them.

    `is_once` if a camera lacks single pictures only, so that `mask_camera` depends on its others.
    """

    cameras: tuple[Broken, ...]
    radars: tuple[Broken, ...]
    others: Mapping[str, Broken]
    is_once: bool = False

    @property
    def topics(self) -> dict[str, Broken]:
        cameras = {f"/cam_{side}/image": one for side, one in zip(SIDES, self.cameras, strict=False)}
        return (
            cameras
            | {f"/radar_{side}/points": one for side, one in zip(RADARS, self.radars, strict=True)}
            | {**self.others}
        )


RIGS = {
    "pictures and points of no known kind": BrokenRig(
        (
            Broken(raw("yuv444_strange"), "yuv444_strange"),
            Broken(raw("32FC1", 4 * WIDTH_PX), "distances"),
            Broken(raw(size=(0, 0)), "0 × 0"),
            Broken(packed(lambda _t: b"\0\0\0\1\x67" + bytes(90), "h264"), "H.264"),
            Broken(packed(lambda _t: b""), "none"),
        ),
        (
            Broken(radar_cloud(INTEGERS), "floats"),
            Broken(radar_cloud(LETTERS), "floats"),
            Broken(radar_cloud(point_step=17, row_step=3), "17 bytes"),
        ),
        {"/lidar_rear/points": Broken(radar_cloud(point_step=17, row_step=3), "17 bytes")},
    ),
    "messages that are empty or cut": BrokenRig(
        (
            Broken(bare(IMAGE, b""), "0 bytes"),
            Broken(packed(lambda t: encoded(t, "PNG")[:300]), "PNG"),
            Broken(packed(short_jpeg), "JPEG"),
        ),
        (
            Broken(bare(CLOUD, b""), "0 bytes"),
            Broken(cut_scan, "radar_msgs/msg/RadarScan"),
            Broken(radar_cloud(count=0), ""),
        ),
        {
            "/imu/data": Broken(bare("sensor_msgs/msg/Imu", b""), "0 bytes"),
            "/tf_static": Broken(bare("tf2_msgs/msg/TFMessage", b""), "0 bytes"),
            "/cam_sound/camera_info": Broken(bare("sensor_msgs/msg/CameraInfo", b""), "0 bytes"),
        },
    ),
    "one message among sound ones": BrokenRig(
        (
            Broken(at_third(packed(short_jpeg), JPEG), ""),
            Broken(at_third(packed(lambda t: encoded(t, "PNG")[:300]), JPEG), ""),
            Broken(at_third(packed(lambda _t: b""), JPEG), "none"),
        ),
        (
            Broken(at_third(radar_cloud(point_step=17, row_step=3), radar_cloud()), "17 bytes"),
            Broken(at_third(radar_cloud(INTEGERS), radar_cloud()), "floats"),
            Broken(at_third(cut_scan, radar_scan), "1 of the"),
        ),
        {},
        is_once=True,
    ),
}
RETURN = "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n"
SCAN = (
    ("radar_msgs/msg/RadarReturn", RETURN),
    (
        "radar_msgs/msg/RadarScan",
        "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n",
    ),
)


def frame_of(topic: str) -> str:
    return topic.split("/")[1]


def written(folder: Path, topics: Mapping[str, Message]) -> tuple[Path, Path]:
    drive = FieldDrive(definitions=SCAN, sweeps=SWEEPS)

    def made(name: str, message: Message) -> Callable[[float], Any]:
        return lambda t: message(drive, t, frame_of(name))

    others = [FieldTopic(name, 0.1, 0.0, made(name, message)) for name, message in topics.items()]
    return drive.write(folder, drive.lidar_topic(), drive.odometry_topic(), *others, sensors=SENSORS)


@pytest.fixture(scope="module")
def labels_without(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The labels of the recording that has the sound sensors alone."""
    folder = tmp_path_factory.mktemp("without")
    run, calibration = written(folder, {SOUND: JPEG})
    assert outcome_of(run, calibration, folder / "labels").refusal == ""
    return folder / "labels"


def assert_named_once(found: FieldOutcome, topic: str, word: str) -> None:
    named = [one for one in found.findings if topic in (one.topic, one.message.split(" ")[0])]
    named = [one for one in named if word and word in one.message]
    assert len(named) == bool(word), topic
    assert {one.severity for one in named} <= {"warning"}


def assert_same_labels(found: FieldOutcome, without: Path, *, has_mask: bool) -> None:
    assert found.labels is not None
    ours, theirs = labelled_frames(found.labels), labelled_frames(without)
    assert list(ours) == list(theirs)
    for stamp, path in ours.items():
        with np.load(path) as one, np.load(theirs[stamp]) as other:
            for name in ("semantics", "mask_lidar", *(("mask_camera",) if has_mask else ())):
                np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
def test_broken_sensors_cost_themselves_in_labels_and_every_export(
    tmp_path: Path, labels_without: Path, rig: BrokenRig
) -> None:
    topics = {name: one.message for name, one in rig.topics.items()}
    run, calibration = written(tmp_path, {SOUND: JPEG, **topics})
    found = outcome_of(run, calibration, tmp_path / "labels")
    assert (found.refusal, found.errors) == ("", [])
    for topic, one in rig.topics.items():
        assert_named_once(found, topic, one.word)
    assert_same_labels(found, labels_without, has_mask=not rig.is_once)
    for name in EXPORTERS:
        request = ExportRequest(name, tmp_path / name, read_report(tmp_path / "labels"))
        source = partial(folder_source, tmp_path / "labels", checked_samples, run)
        export(request, source, lambda _done, _total: None)
    assert [str(fault) for fault in check_dataset(tmp_path / "nuscenes").faults.found] == []
    with open_bag(run) as bag:
        inspection = inspect_in(bag)
        quality_of(bag, inspection)
        assert list(previews_of(bag, inspection))
