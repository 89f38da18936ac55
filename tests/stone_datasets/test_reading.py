"""The index of a dataset says what its tables say, whatever their order, their formatting and where they lie."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from stone_datasets.index import DatasetIndex, DatasetSequence
from stone_datasets.labels import read_labels
from stone_datasets.reading import check_dataset, read_dataset
from stone_datasets.rows import DatasetRow
from testing.refusals import refused_as
from testing.worlds.published_datasets import (
    LOGFILE,
    VERSION,
    SyntheticDataset,
    made_labels,
    pose_of,
    tables_of,
    write_published,
    write_published_tar,
)
from testing.worlds.small_export import FOCAL_PX, PICTURE_PX
from tests.stone_datasets.conftest import GOOD, Rows, reannotated, rewritten


def said(sequence: DatasetSequence) -> object:
    """Everything of a sequence as plain values."""
    channels = {
        name: (
            vars(one.sensor) | {"ego_from_sensor": one.sensor.ego_from_sensor.wxyz_xyz.tolist()},
            one.frames.tolist(),
            one.stamps_ns.tolist(),
            one.map_from_ego.wxyz_xyz.tolist(),
            [one.filename(place) for place in range(len(one.frames))],
        )
        for name, one in sequence.channels.items()
    }
    facts = (sequence.name, sequence.tokens, sequence.stamps_ns.tolist(), sequence.is_labelled, sequence.splits)
    return (facts, sequence.map_from_ego.wxyz_xyz.tolist(), channels)


def everything(index: DatasetIndex) -> object:
    return ([said(one) for one in index.sequences], dict(index.splits))


def test_frames_channels_and_labels_are_those_of_the_tables(good: Path) -> None:
    index = read_dataset(good)
    assert [one.name for one in index.sequences] == list(GOOD.names)
    for scene, sequence in enumerate(index.sequences):
        assert sequence.tokens == GOOD.tokens(scene)
        assert sequence.stamps_ns.tolist() == [GOOD.stamp_us(scene, frame) * 1000 for frame in range(3)]
        poses = [pose_of(GOOD, scene, GOOD.stamp_us(scene, frame)) for frame in range(3)]
        assert sequence.map_from_ego.wxyz.tolist() == [pose["rotation"] for pose in poses]
        assert sequence.map_from_ego.translation_m.tolist() == [pose["translation"] for pose in poses]
        assert (sequence.logfile, sequence.vehicle, sequence.location) == (LOGFILE, "rover", "field")
    assert index.sequences[1].splits == ("val",)
    channel = index.sequences[1].channels["CAM_BACK"]
    lens = channel.sensor.intrinsics
    assert lens is not None
    assert (lens.model, lens.width_px, lens.height_px, lens.fx_px) == ("plumb_bob", *PICTURE_PX, FOCAL_PX)
    assert channel.sensor.ego_from_sensor.wxyz_xyz.tolist() == [0.5, -0.5, 0.5, -0.5, 0.1, -0.2, 1.0]
    stamps_us = [GOOD.datum_us(1, frame, "CAM_BACK") for frame in range(3)]
    assert channel.stamps_ns.tolist() == [stamp_us * 1000 for stamp_us in stamps_us]
    assert [channel.filename(place) for place in range(3)] == [GOOD.filename("CAM_BACK", us) for us in stamps_us]
    span = index.file(channel, 2)
    assert span is not None
    assert span.path == good / GOOD.filename("CAM_BACK", stamps_us[2])
    for frame, seed in ((0, 1), (1, 2), (2, 1)):
        span = index.labels(index.sequences[0], frame)
        assert span is not None
        labels = read_labels(span)
        with np.load(span.path) as arrays:
            assert np.array_equal(labels.classes, arrays["semantics"])
            assert labels.mask_lidar is not None
            assert np.array_equal(labels.mask_lidar, arrays["mask_lidar"])
        assert span.read(1 << 20) == made_labels(seed)


@pytest.mark.parametrize("root", ["", "./", "top/", "a/long/" + "way/" * 40])
def test_a_tar_is_read_as_the_folder_is(good: Path, tmp_path: Path, root: str) -> None:
    path = write_published_tar(tmp_path / "published.tar", GOOD, root)
    index = read_dataset(path)
    assert everything(index) == everything(read_dataset(good))
    span = index.labels(index.sequences[0], 0)
    assert span is not None
    assert span.read(1 << 20) == made_labels(1)
    assert index.labels(index.sequences[0], 1) is not None
    assert index.files.span("gts/none/labels.npz") is None


def test_a_folder_around_the_dataset_and_the_order_of_rows_change_nothing(good: Path, copied: Path) -> None:
    (copied.parent / "other").mkdir()
    assert everything(read_dataset(copied.parent)) == everything(read_dataset(good))
    for table in ("sensor", "calibrated_sensor", "sample", "ego_pose", "sample_data"):
        rewritten(copied, table, list.reverse)
    found = read_dataset(copied)
    assert [said(one) for one in found.sequences] == [said(one) for one in read_dataset(good).sequences]
    rewritten(copied, "scene", list.reverse)
    assert [one.name for one in read_dataset(copied).sequences] == list(reversed(GOOD.names))


def test_sweeps_between_key_frames_are_checked_and_left_out(good: Path, copied: Path) -> None:
    def insert(rows: Rows) -> None:
        """Between the first two sweeps of the first scene."""
        first, second = rows[0], rows[4]
        stamp_us = first["timestamp"] + 50_000
        name = f"sweeps/LIDAR_TOP/{LOGFILE}__LIDAR_TOP__{stamp_us}.pcd.bin"
        between = first | {"token": "e" * 32, "timestamp": stamp_us, "is_key_frame": False, "filename": name}
        rows.append(between | {"prev": first["token"], "next": second["token"]})
        first["next"] = second["prev"] = "e" * 32

    rewritten(copied, "sample_data", insert)
    assert everything(read_dataset(copied)) == everything(read_dataset(good))


def test_a_test_set_without_labels_is_one(tmp_path: Path) -> None:
    unlabelled = SyntheticDataset(scenes=1, frames=2)
    check = check_dataset(write_published(tmp_path / "test", unlabelled))
    assert check.contents is not None
    record = check.contents.as_record()
    assert (record["frames"], record["labelled_frames"]) == (2, 0)
    assert record["class_share_of_occupied"] == {"T": None, "P": None, "N": None}


def test_a_check_counts_frames_files_classes_and_bytes(good: Path) -> None:
    check = check_dataset(good)
    assert check.contents is not None
    record = check.contents.as_record()
    assert record["sensors"] == {"CAM_BACK": 6, "CAM_FRONT": 6, "LIDAR_TOP": 6, "RADAR_FRONT": 6}
    assert record["splits"] == {"train": ["field-0000"], "val": ["field-0001"]}
    assert record["masks"] == {"mask_lidar": 6, "mask_camera": 6}
    files = [path for part in ("samples", "gts") for path in (good / part).rglob("*") if path.is_file()]
    assert record["size_bytes"] == sum(path.stat().st_size for path in files)
    counted = np.zeros(4, np.int64)
    for path in (good / "gts").rglob("labels.npz"):
        counted += np.bincount(np.load(path)["semantics"].reshape(-1), minlength=4)
    assert list(record["voxels"].values()) == counted.tolist()
    assert sum(record["class_share_of_occupied"].values()) == pytest.approx(1)


def test_annotations_alone_are_a_dataset_of_cameras(good: Path, good_annotated: Path) -> None:
    index, tables = read_dataset(good_annotated), read_dataset(good)
    assert (index.layout.name, index.files.version) == ("paper", "")
    for sequence, wanted in zip(index.sequences, tables.sequences, strict=True):
        assert sequence.tokens == wanted.tokens
        assert sequence.stamps_ns.tolist() == wanted.stamps_ns.tolist()
        assert np.array_equal(sequence.map_from_ego.wxyz_xyz, wanted.map_from_ego.wxyz_xyz)
        assert sequence.splits == wanted.splits
        assert set(sequence.channels) == {"CAM_FRONT", "CAM_BACK"}
        for name, channel in sequence.channels.items():
            other = wanted.channels[name]
            assert channel.stamps_ns.tolist() == other.stamps_ns.tolist()
            assert np.array_equal(channel.map_from_ego.wxyz_xyz, other.map_from_ego.wxyz_xyz)
            assert channel.sensor.intrinsics is not None
            assert channel.sensor.intrinsics.fx_px == FOCAL_PX
    check = check_dataset(good_annotated)
    assert check.contents is not None
    assert check.contents.labelled == 6


def test_frames_of_annotations_come_by_stamp(good_annotated: Path, copied_annotated: Path) -> None:
    def turn(content: dict[str, object]) -> None:
        infos = content["scene_infos"]
        assert isinstance(infos, dict)
        content["scene_infos"] = {name: dict(reversed(frames.items())) for name, frames in infos.items()}

    reannotated(copied_annotated, turn)
    found, wanted = read_dataset(copied_annotated), read_dataset(good_annotated)
    assert [said(one) for one in found.sequences] == [said(one) for one in wanted.sequences]


def test_annotations_beside_tables_say_the_splits_and_are_compared(copied: Path, good_annotated: Path) -> None:
    (copied / "splits.json").unlink()
    (copied / "annotations.json").write_bytes((good_annotated / "annotations.json").read_bytes())
    assert read_dataset(copied).splits == {"train": ("field-0000",), "val": ("field-0001",)}
    reannotated(copied, lambda content: content["scene_infos"]["field-0000"].update({"e" * 32: {}}))
    faults = check_dataset(copied).faults.found
    assert [fault.code for fault in faults] == ["DST-030"]
    assert "the tables have no frame of 'field-0000'" in str(faults[0])


def test_the_first_fault_is_raised_where_a_dataset_is_only_read(copied: Path, tmp_path: Path) -> None:
    (copied / VERSION / "scene.json").unlink()
    with refused_as("DST-010"):
        read_dataset(copied)
    (tmp_path / "empty").mkdir()
    with refused_as("DST-001"):
        read_dataset(tmp_path / "empty")


def test_faults_beyond_the_limit_are_counted(copied: Path) -> None:
    rewritten(copied, "ego_pose", lambda rows: [row.update(rotation=[2, 0, 0, 0]) for row in rows])
    faults = check_dataset(copied, most=5).faults
    assert (len(faults.found), faults.total) == (5, 24)


def test_faults_of_one_stage_are_all_told_and_those_that_follow_from_them_are_not(copied: Path) -> None:
    rewritten(copied, "sensor", lambda rows: rows[0].update(modality="lidr"))
    rewritten(copied, "sample", lambda rows: rows[0].update(timestamp="x"))
    check = check_dataset(copied)
    assert check.reached == "rows"
    assert [fault.place.file for fault in check.faults.found] == [f"{VERSION}/sensor.json", f"{VERSION}/sample.json"]


def test_a_row_of_a_fault_is_its_place_in_the_table(copied: Path) -> None:
    rewritten(copied, "ego_pose", lambda rows: rows[17].update(rotation=[2, 0, 0, 0]))
    record = check_dataset(copied).faults.found[0].as_record()
    wanted = list(tables_of(GOOD)["ego_pose"])[17]["token"]
    assert record | {"message": ""} == {
        "code": "DST-022",
        "file": f"{VERSION}/ego_pose.json",
        "row": 18,
        "token": wanted,
        "message": "",
        "rows": 1,
    }


def test_poses_are_what_the_table_says_to_the_last_bit(copied: Path) -> None:
    rotation, translation = [0.9999999999999998, 1e-17, -0.0, 2.0e-8], [1234567.891234567, -0.1, 1e-300]
    rewritten(copied, "ego_pose", lambda rows: rows[0].update(rotation=rotation, translation=translation))
    assert read_dataset(copied).sequences[0].map_from_ego[0].wxyz_xyz.tolist() == [*rotation, *translation]
    row = DatasetRow("t", 1, {"rotation": rotation, "translation": translation})
    assert row.pose(1e7).wxyz_xyz.tolist() == [*rotation, *translation]


MOST_BYTES_A_DATUM = 1000  # at its peak, its frame's share with it; two rows as dictionaries are 2,000


def peak_bytes(path: Path) -> int:
    tracemalloc.start()
    try:
        read_dataset(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.whole
def test_memory_grows_by_bytes_a_datum(tmp_path: Path) -> None:
    short = write_published_tar(tmp_path / "short.tar", SyntheticDataset(scenes=4, frames=100))
    long = write_published_tar(tmp_path / "long.tar", SyntheticDataset(scenes=4, frames=400))
    read_dataset(short)  # what is cached, regular expressions and the like
    data = 4 * (400 - 100) * len(SyntheticDataset().sensors)
    assert peak_bytes(long) - peak_bytes(short) < MOST_BYTES_A_DATUM * data
