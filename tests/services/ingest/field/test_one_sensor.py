"""A sensor that cannot be read costs itself: labels are those without it, and every export is written."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.registry import EXPORTERS
from services.labeler.exports.source import folder_source, read_report
from stone.findings import Finding
from stone_datasets.reading import check_dataset
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect_in
from stone_recordings.report.previews.pictures import previews_of
from stone_recordings.report.quality.report import quality_of
from stone_recordings.sync.samples import checked_samples
from testing.worlds.field import drive as field_drive
from testing.worlds.field.drive import BareMessage, FieldDrive, FieldTopic
from testing.worlds.field.outcome import FieldOutcome, labelled_frames, outcome_of

SWEEPS = 8
WIDTH_PX, HEIGHT_PX = 64, 48
IMAGE, PACKED, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2"
CAMERA, RADAR, REAR = "/cam_front/image", "/radar_front/points", "/lidar_rear/points"
SENSORS = (
    "{CAM_FRONT: {kind: camera, frame_id: cam_front, lidar_from_sensor: {translation_m: [0.2, 0, -0.1], "
    "rotation_wxyz: [0.5, -0.5, 0.5, -0.5]}, intrinsics: {model: plumb_bob, width_px: 64, height_px: 48, fx_px: 40, "
    "fy_px: 40, cx_px: 32, cy_px: 24, distortion: [0, 0, 0, 0, 0]}}, RADAR_FRONT: {kind: radar, frame_id: radar_front, "
    "lidar_from_sensor: {translation_m: [0.3, 0, -0.3], rotation_wxyz: [1, 0, 0, 0]}}}"
)
RADAR_POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("v", "f4"), ("rcs", "f4")])
Message = Callable[[FieldDrive, float], Any]


def encoded(t: float, kind: str) -> bytes:
    file = BytesIO()
    pixels = np.random.default_rng(round(t * 10) + 9).integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, kind)
    return file.getvalue()


def raw(encoding: str = "rgb8", step: int = 3 * WIDTH_PX, size: tuple[int, int] = (HEIGHT_PX, WIDTH_PX)) -> Message:
    def message(drive: FieldDrive, t: float) -> Any:
        data = np.full(size[0] * step, 90, np.uint8)
        return drive.of(IMAGE, drive.header(t + 0.02, "cam_front"), *size, encoding, 0, step, data)

    return message


def packed(of: Callable[[float], bytes], text: str = "jpeg") -> Message:
    def message(drive: FieldDrive, t: float) -> Any:
        data = np.frombuffer(of(t), np.uint8)
        return drive.of(PACKED, drive.header(t + 0.02, "cam_front"), text, data)

    return message


def short_jpeg(t: float) -> bytes:
    whole = encoded(t, "JPEG")
    return whole[: whole.index(b"\xff\xda") + 20]


def bare(kind: str, content: bytes) -> Message:
    return lambda _drive, _t: BareMessage(kind, content)


def at_third(broken: Message, sound: Message) -> Message:
    return lambda drive, t: (broken if round(t * 10) == 3 else sound)(drive, t)


def radar_cloud(record: np.dtype[Any] = RADAR_POINT, count: int = 30, **other: Any) -> Message:
    def message(drive: FieldDrive, t: float) -> Any:
        points = np.zeros(count, record)
        for number, name in enumerate(name for name in ("x", "y", "z") if name in (record.names or ())):
            points[name] = np.arange(count) % 7 + 2 + number
        return drive.cloud(t, points, "radar_front", **other)

    return message


def radar_scan(drive: FieldDrive, t: float) -> Any:
    one = drive.of("radar_msgs/msg/RadarReturn", 9.0, 0.1, 0.0, 1.0, 12.0)
    return drive.of("radar_msgs/msg/RadarScan", drive.header(t, "radar_front"), [one] * 9)


def cut_scan(drive: FieldDrive, t: float) -> Any:
    whole = drive.store.serialize_cdr(radar_scan(drive, t), "radar_msgs/msg/RadarScan")
    return BareMessage("radar_msgs/msg/RadarScan", bytes(whole)[:-30])


JPEG = packed(lambda t: encoded(t, "JPEG"))
INTEGERS = np.dtype([("x", "i4"), ("y", "i4"), ("z", "i4"), ("rcs", "f4")])
LETTERS = np.dtype([("a", "f4"), ("rcs", "f4")])


@dataclass(frozen=True)
class Broken:
    """A topic whose messages cannot be read, all or one of them, and a word of what is said of it ("" for nothing)."""

    topic: str
    message: Message
    word: str
    is_once: bool = False


CASES: Mapping[str, Broken] = {
    "encoding that is not read": Broken(CAMERA, raw("yuv444_strange"), "yuv444_strange"),
    "depth": Broken(CAMERA, raw("32FC1", 4 * WIDTH_PX), "distances"),
    "no pixels": Broken(CAMERA, raw(size=(0, 0)), "0 × 0"),
    "video": Broken(CAMERA, packed(lambda _t: b"\0\0\0\1\x67" + bytes(90), "h264"), "H.264"),
    "empty pictures": Broken(CAMERA, packed(lambda _t: b""), "none"),
    "empty camera messages": Broken(CAMERA, bare(IMAGE, b""), "0 bytes"),
    "damaged PNG": Broken(CAMERA, packed(lambda t: encoded(t, "PNG")[:300]), "PNG"),
    "damaged JPEG": Broken(CAMERA, packed(short_jpeg), "JPEG"),
    "one damaged JPEG": Broken(CAMERA, at_third(packed(short_jpeg), JPEG), "", is_once=True),
    "one damaged PNG": Broken(CAMERA, at_third(packed(lambda t: encoded(t, "PNG")[:300]), JPEG), "", is_once=True),
    "one empty picture": Broken(CAMERA, at_third(packed(lambda _t: b""), JPEG), "none", is_once=True),
    "radar of integers": Broken(RADAR, radar_cloud(INTEGERS), "floats"),
    "radar without places": Broken(RADAR, radar_cloud(LETTERS), "floats"),
    "radar of a wrong layout": Broken(RADAR, radar_cloud(point_step=17, row_step=3), "17 bytes"),
    "empty radar messages": Broken(RADAR, bare(CLOUD, b""), "0 bytes"),
    "one wrong scan": Broken(
        RADAR, at_third(radar_cloud(point_step=17, row_step=3), radar_cloud()), "17 bytes", is_once=True
    ),
    "one scan of integers": Broken(RADAR, at_third(radar_cloud(INTEGERS), radar_cloud()), "floats", is_once=True),
    "radar that sees nothing": Broken(RADAR, radar_cloud(count=0), "", is_once=True),
    "radar list that is cut": Broken(RADAR, cut_scan, "radar_msgs/msg/RadarScan"),
    "one radar list that is cut": Broken(RADAR, at_third(cut_scan, radar_scan), "1 of the", is_once=True),
    "empty IMU messages": Broken("/imu/data", bare("sensor_msgs/msg/Imu", b""), "0 bytes"),
    "empty static transforms": Broken("/tf_static", bare("tf2_msgs/msg/TFMessage", b""), "0 bytes"),
    "empty intrinsics": Broken("/cam_front/camera_info", bare("sensor_msgs/msg/CameraInfo", b""), "0 bytes"),
    "another LiDAR of a wrong layout": Broken(REAR, radar_cloud(point_step=17, row_step=3), "17 bytes"),
}
RETURN = "float32 range\nfloat32 azimuth\nfloat32 elevation\nfloat32 doppler_velocity\nfloat32 amplitude\n"
SCAN = (
    ("radar_msgs/msg/RadarReturn", RETURN),
    (
        "radar_msgs/msg/RadarScan",
        "std_msgs/Header header\nradar_msgs/RadarReturn[] returns\n",
    ),
)
QUICK = ("encoding that is not read", "one damaged PNG", "radar of integers")


def written(folder: Path, topics: Mapping[str, Message]) -> tuple[Path, Path]:
    drive = FieldDrive(definitions=SCAN)

    def made(message: Message) -> Callable[[float], Any]:
        return lambda t: message(drive, t)

    others = [FieldTopic(name, 0.1, 0.0, made(message)) for name, message in topics.items()]
    return drive.write(folder, drive.lidar_topic(), drive.odometry_topic(), *others, sensors=SENSORS)


@pytest.fixture(autouse=True)
def short_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field_drive, "SWEEPS", SWEEPS)


def exported(labels: Path, bag: Path, formats: tuple[str, ...]) -> dict[str, Path]:
    outs = {name: labels.with_name(f"export-{name}") for name in formats}
    for name, out in outs.items():
        request = ExportRequest(name, out, read_report(labels))
        export(request, lambda: folder_source(labels, checked_samples, bag), lambda _done, _total: None)
    return outs


def mentions(findings: tuple[Finding, ...], topic: str) -> list[Finding]:
    return [finding for finding in findings if topic in (finding.topic, finding.message.split(" ")[0])]


def assert_costs_itself(folder: Path, case: Broken, formats: tuple[str, ...]) -> None:
    sound = {CAMERA: JPEG, RADAR: radar_cloud()}
    run, calibration = written(folder / "case", {**sound, case.topic: case.message})
    found = outcome_of(run, calibration, folder / "case" / "labels")
    assert (found.refusal, found.errors) == ("", [])
    named = [one for one in mentions(found.findings, case.topic) if case.word and case.word in one.message]
    assert len(named) == bool(case.word)
    assert {one.severity for one in named} <= {"warning"}
    without, other_calibration = written(
        folder / "without", {name: sound[name] for name in sound if name != case.topic}
    )
    assert outcome_of(without, other_calibration, folder / "without" / "labels").refusal == ""
    assert_same_labels(found, folder / "without" / "labels", has_mask=not case.is_once)
    outs = exported(folder / "case" / "labels", run, formats)
    if "nuscenes" in outs:
        assert_sound_dataset(outs["nuscenes"])
    with open_bag(run) as bag:
        inspection = inspect_in(bag)
        quality_of(bag, inspection)
        assert list(previews_of(bag, inspection))


def assert_same_labels(found: FieldOutcome, without: Path, *, has_mask: bool) -> None:
    assert found.labels is not None
    ours, theirs = labelled_frames(found.labels), labelled_frames(without)
    assert list(ours) == list(theirs)
    for stamp, path in ours.items():
        with np.load(path) as one, np.load(theirs[stamp]) as other:
            for name in ("semantics", "mask_lidar", *(("mask_camera",) if has_mask else ())):
                np.testing.assert_array_equal(one[name], other[name])


def assert_sound_dataset(folder: Path) -> None:
    found = check_dataset(folder)
    assert [str(fault) for fault in found.faults.found] == []


@pytest.mark.parametrize("name", QUICK)
def test_a_broken_sensor_costs_itself(tmp_path: Path, name: str) -> None:
    assert_costs_itself(tmp_path, CASES[name], ("nuscenes", "playback"))


@pytest.mark.whole
@pytest.mark.parametrize("name", CASES)
def test_a_broken_sensor_costs_itself_in_every_export(tmp_path: Path, name: str) -> None:
    assert_costs_itself(tmp_path, CASES[name], tuple(EXPORTERS))
