"""Frames of exports: every datum with its time, pose and mount; tables that lie are refused, by name."""

import io
import json
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from stone_base.label_grid import RELEASE
from stone_exports.files import DamagedExportError, ExportFileSpan, FolderFiles
from stone_exports.frames import ExportedFrame, frames_in
from stone_exports.labels import observed_classes
from stone_files.npz import npz_bytes
from testing.refusals import refused_as
from testing.worlds import small_export
from tests.stone_exports.conftest import RIG

Rows = list[dict[str, Any]]


def frames(folder: Path) -> tuple[ExportedFrame, ...]:
    return frames_in(FolderFiles(folder))


def rewritten(folder: Path, table: str, change: Callable[[Rows], object]) -> Path:
    """The export with other rows in a table."""
    rows = json.loads((folder / "v1.0-trainval" / f"{table}.json").read_text())
    change(rows)
    small_export.write_table(folder, table, rows)
    return folder


def test_frames_come_by_time_with_all_their_sensors_their_poses_and_lenses(rig: Path) -> None:
    found = frames(rig)
    assert tuple(frame.token for frame in found) == RIG.tokens
    assert [frame.stamp_us for frame in found] == [small_export.START_US, small_export.START_US + small_export.STEP_US]
    assert {frame.sequence for frame in found} == {"meadow"}
    assert all(set(frame.data) == {"LIDAR_TOP", *small_export.CAMERAS, "RADAR_FRONT"} for frame in found)
    assert [datum.sensor.channel for datum in found[0].of_modality("camera")] == sorted(small_export.CAMERAS)
    picture = frames(rig)[1].data["CAM_FRONT"]
    assert picture.stamp_us == small_export.START_US + small_export.STEP_US + small_export.EXPOSURE_US
    np.testing.assert_allclose(
        picture.global_from_ego.as_matrix(), small_export.global_from_ego(picture.stamp_us).as_matrix()
    )
    np.testing.assert_allclose(picture.sensor.ego_from_sensor.translation_m, small_export.LIDAR_M)
    lens = frames(rig)[0].data["CAM_BACK"].sensor.intrinsics
    assert lens is not None
    assert (lens.model, lens.width_px, lens.height_px) == ("plumb_bob", *small_export.PICTURE_PX)
    assert (lens.fx_px, lens.cx_px, lens.distortion) == (small_export.FOCAL_PX, 31.5, RIG.lens[1])


def test_labels_are_those_of_the_frame_where_there_are_some(copied: Path) -> None:
    first, second = RIG.tokens
    (copied / "gts" / "meadow" / second / "labels.npz").unlink()
    with_labels, without = frames(copied)
    assert with_labels.labels is not None
    assert with_labels.labels.path == copied / "gts" / "meadow" / first / "labels.npz"
    assert without.labels is None


def test_order_of_rows_does_not_matter(rig: Path, copied: Path) -> None:
    for table in ("sample", "sample_data", "ego_pose", "calibrated_sensor"):
        rewritten(copied, table, list.reverse)
    assert [frame.token for frame in frames(copied)] == [frame.token for frame in frames(rig)]


def test_what_is_no_key_frame_or_of_no_known_sensor_is_left(copied: Path) -> None:
    def change(rows: Rows) -> None:
        of(rows, "CAM_FRONT").update(is_key_frame=False)
        of(rows, "CAM_BACK").update(calibrated_sensor_token="another rig's")

    rewritten(copied, "sample_data", change)
    assert set(frames(copied)[0].data) == {"LIDAR_TOP", *small_export.CAMERAS, "RADAR_FRONT"} - {
        "CAM_FRONT",
        "CAM_BACK",
    }


def test_a_frame_without_a_sweep_is_none(copied: Path) -> None:
    rewritten(copied, "sample_data", lambda rows: rows.remove(of(rows, "LIDAR_TOP")))
    assert [frame.token for frame in frames(copied)] == [RIG.tokens[1]]


def of(rows: Rows, channel: str) -> dict[str, Any]:
    """The first row of this channel, in whichever table."""
    return next(row for row in rows if f"/{channel}/" in row.get("filename", "") or row["token"] == f"mount-{channel}")


ATTACKS: dict[str, tuple[str, Callable[[Rows], object]]] = {
    "no pose": ("sample_data", lambda rows: of(rows, "LIDAR_TOP").update(ego_pose_token="x")),
    "no file": ("sample_data", lambda rows: of(rows, "CAM_FRONT").update(filename="samples/a.jpg")),
    "a file elsewhere": ("sample_data", lambda rows: of(rows, "CAM_FRONT").update(filename="../../etc/x")),
    "a stamp of text": ("sample_data", lambda rows: of(rows, "LIDAR_TOP").update(timestamp="now")),
    "a stamp of -2^62": ("sample", lambda rows: rows[0].update(timestamp=-(1 << 62))),
    "a stamp of 2^62": ("sample", lambda rows: rows[0].update(timestamp=1 << 62)),
    "a stamp in seconds": ("sample", lambda rows: rows[0].update(timestamp=1.7e9)),
    "a pose that scales": ("ego_pose", lambda rows: rows[0].update(rotation=[2, 0, 0, 0])),
    "a pose far away": ("ego_pose", lambda rows: rows[0].update(translation=[1e8, 0, 0])),
    "a pose that is no number": ("ego_pose", lambda rows: rows[0].update(translation=[float("nan")] * 3)),
    "a frame of no sequence": ("sample", lambda rows: rows[0].update(scene_token="x")),
    "a token that is none": ("sample", lambda rows: rows[0].update(token="../x")),
    "a sequence above": ("scene", lambda rows: rows[0].update(name="../..")),
    "a mount of nothing": ("calibrated_sensor", lambda rows: rows[0].update(sensor_token="x")),
    "a mount on the moon": ("calibrated_sensor", lambda rows: rows[0].update(translation=[0, 0, 4e8])),
}  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_tables_that_lie_are_refused(copied: Path, attack: str) -> None:
    table, change = ATTACKS[attack]
    with pytest.raises(DamagedExportError) as refused:
        frames(rewritten(copied, table, change))
    assert f"v1.0-trainval/{table}.json" in str(refused.value)


LENSES: dict[str, dict[str, Any]] = {
    "no matrix": {"camera_intrinsic": []},
    "a matrix of text": {"camera_intrinsic": [["a"]]},
    "a focal length of zero": {"camera_intrinsic": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]},
    "a centre that is no number": {"camera_intrinsic": [[1, 0, float("nan")], [0, 1, 1], [0, 0, 1]]},
    "a model that is none": {"camera_model": "omnidirectional"},
    "a model of a list": {"camera_model": ["pinhole"]},
    "four coefficients": {"camera_distortion": [0.1, 0, 0, 0]},
    "a pinhole that bends": {"camera_model": "pinhole"},
    "too few of eight": {"camera_model": "rational_polynomial"},
    "too many of four": {"camera_model": "equidistant"},
    "endless coefficients": {"camera_distortion": [float("inf")] * 5},
    "coefficients of null": {"camera_distortion": None},
}


@pytest.mark.parametrize("lie", LENSES)
def test_a_lens_that_is_none_is_refused(copied: Path, lie: str) -> None:
    rewritten(copied, "calibrated_sensor", lambda rows: of(rows, "CAM_FRONT").update(LENSES[lie]))
    with pytest.raises(DamagedExportError):
        frames(copied)


def test_a_camera_of_no_size_has_no_lens(copied: Path) -> None:
    def shrink(rows: Rows) -> None:
        for row in rows:
            row.update(width=0)

    rewritten(copied, "sample_data", shrink)
    assert frames(copied)[0].data["CAM_FRONT"].sensor.intrinsics is None


def test_a_table_that_is_missing_is_named(copied: Path) -> None:
    (copied / "v1.0-trainval" / "ego_pose.json").unlink()
    with pytest.raises(DamagedExportError):
        frames(copied)


SHAPE = (256, 256, 32)
Grid = NDArray[np.uint8]


def span_of(path: Path, content: bytes) -> ExportFileSpan:
    path.write_bytes(content)
    return ExportFileSpan(path, path.name, 0, len(content))


def grids(**arrays: Grid) -> dict[str, Grid]:
    return {"semantics": np.zeros(SHAPE, np.uint8), "mask_lidar": np.ones(SHAPE, np.uint8)} | arrays


def header(text: str) -> bytes:
    return b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text.encode()


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def test_what_nobody_observed_is_ignored_and_a_surface_is_observed(tmp_path: Path) -> None:
    semantics, mask = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
    semantics[1, 2, 3], semantics[4, 5, 6], mask[4, 5, 6], mask[7, 8, 9] = 3, 1, 1, 255
    found = observed_classes(span_of(tmp_path / "labels.npz", npz_bytes(grids(semantics=semantics, mask_lidar=mask))))
    assert (found[1, 2, 3], found[4, 5, 6], found[7, 8, 9], found[0, 0, 0]) == (3, 1, 0, 255)
    assert (found == 255).sum() == found.size - 3


def test_ours_and_numpys_files_read_alike(rig: Path, tmp_path: Path) -> None:
    span = frames_in(FolderFiles(rig))[0].labels
    assert span is not None
    with np.load(span.path) as arrays:
        semantics, mask = arrays["semantics"], arrays["mask_lidar"]
        for save in (np.savez, np.savez_compressed):
            save(tmp_path / "again.npz", **arrays)
            again = ExportFileSpan(tmp_path / "again.npz", "a", 0, (tmp_path / "again.npz").stat().st_size)
            assert np.array_equal(observed_classes(again), observed_classes(span))
    assert np.array_equal(observed_classes(span), np.where((mask == 0) & (semantics == 0), 255, semantics))


NPY = npz_bytes(grids())


def headed(kind: str, is_fortran: bool, shape: tuple[int, ...]) -> bytes:
    """An npz of semantics that end behind their header."""
    return zipped(
        {"semantics.npy": header(f"{{'descr': '{kind}', 'fortran_order': {is_fortran}, 'shape': {shape}, }}\n")}
    )


LIES: dict[str, Callable[[], bytes]] = {
    "class 7": lambda: npz_bytes(grids(semantics=np.full(SHAPE, 7, np.uint8))),
    "another shape": lambda: npz_bytes(grids(semantics=np.zeros((256, 256, 31), np.uint8))),
    "a mask of another shape": lambda: npz_bytes(grids(mask_lidar=np.zeros(3, np.uint8))),
    "another type": lambda: npz_bytes(grids(semantics=np.zeros(SHAPE, np.int8))),
    "no mask": lambda: npz_bytes({"semantics": np.zeros(SHAPE, np.uint8)}),
    "no zip": lambda: b"labels",
    "nothing": lambda: b"",
    "cut": lambda: NPY[: len(NPY) // 2],
    "flipped bytes": lambda: NPY[:60] + bytes(b ^ 255 for b in NPY[60:90]) + NPY[90:],
    "no array": lambda: zipped({"semantics.npy": b"x", "mask_lidar.npy": b"x"}),
    "an array that ends early": lambda: headed("|u1", False, SHAPE),
    "packed otherwise": lambda: zipped({"semantics.npy": b"x"}, zipfile.ZIP_LZMA),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_what_is_no_labels_is_refused(lie: str, tmp_path: Path) -> None:
    with pytest.raises(DamagedExportError):
        observed_classes(span_of(tmp_path / "labels.npz", LIES[lie]()))


@pytest.mark.parametrize(
    ("kind", "is_fortran", "shape"), [("|u1", True, SHAPE), ("|u1", False, (10**15,)), ("|O", False, (1,))]
)
def test_an_array_of_another_order_size_or_type_is_refused_by_its_header(tmp_path, kind, is_fortran, shape) -> None:
    with pytest.raises(DamagedExportError, match="expected uint8"):
        observed_classes(span_of(tmp_path / "labels.npz", headed(kind, is_fortran, shape)))


def bomb(says_bytes: int) -> bytes:
    """A member of 256 MiB of zeros, whose directory says it has `says_bytes`."""
    file = bytearray(zipped({"semantics.npy": bytes(1 << 28), "mask_lidar.npy": b""}))
    for mark, at in ((b"PK\3\4", 22), (b"PK\1\2", 24)):
        place = file.index(mark) + at
        file[place : place + 4] = says_bytes.to_bytes(4, "little")
    return bytes(file)


@pytest.mark.whole
@pytest.mark.parametrize("says_bytes", [1 << 28, 2_097_280, 100])
def test_a_zip_bomb_costs_no_memory_whatever_it_says_of_its_size(says_bytes: int, tmp_path: Path) -> None:
    span = span_of(tmp_path / "labels.npz", bomb(says_bytes))
    tracemalloc.start()
    try:
        with pytest.raises(DamagedExportError):
            observed_classes(span)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


def test_labels_that_are_encrypted_or_a_gigabyte_are_refused(tmp_path: Path) -> None:
    content = bytearray(NPY)
    content[6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    with pytest.raises(DamagedExportError):
        observed_classes(span_of(tmp_path / "labels.npz", bytes(content)))
    with pytest.raises(DamagedExportError):
        observed_classes(ExportFileSpan(tmp_path / "labels.npz", "labels.npz", 0, 1 << 30))


def test_labels_of_the_releases_key_are_of_its_grid_and_unobserved_where_they_are_unknown(tmp_path: Path) -> None:
    label = np.random.default_rng(5).choice(np.array([0, 1, 2, 3, 255], np.uint8), RELEASE.shape)
    span = span_of(tmp_path / "labels.npz", npz_bytes({"label": label}))
    assert np.array_equal(observed_classes(span, grid=RELEASE), label)
    own = replace(RELEASE, name="own", unknown=17)
    with refused_as("damaged_export", match="it has class 255"):
        observed_classes(span, grid=own)
    with refused_as("damaged_export", match="expected uint8"):
        observed_classes(span)
