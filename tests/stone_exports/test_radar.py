"""Radar scans of exports: what our exporter wrote comes back; heads that lie are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.labeler.exports.nuscenes.clouds import RADAR_RECORD, radar_bytes
from stone.geometry.se3 import SE3
from stone.sensors.samples import RadarSample
from stone_exports.files import DamagedExportError, ExportFileSpan, FolderFiles
from stone_exports.frames import ExportedDatum, ExportedSensor, frames_in
from stone_exports.radar import detections_ego

QUARTER = SE3.from_parts(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]), np.array([1.0, 0.0, 0.5]))
Rows = NDArray[np.float64]
SEEN = st.tuples(st.floats(1, 200), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-60, 60), st.floats(-40, 40))


def datum_of(path: Path, content: bytes, mount: SE3 = QUARTER) -> ExportedDatum:
    path.write_bytes(content)
    sensor = ExportedSensor("RADAR_FRONT", "radar", mount, None)
    return ExportedDatum(sensor, 0, SE3.identity(), ExportFileSpan(path, path.name, 0, len(content)))


def scan(points: Rows, rates: Rows, rcs_db: Rows) -> bytes:
    return radar_bytes(RadarSample(0, points, points, rates, rates / 2, rcs_db.astype(np.float32)))


@given(st.lists(SEEN, min_size=1, max_size=30))
def test_detections_read_back_are_those_written(
    tmp_path_factory: pytest.TempPathFactory, seen: list[tuple[float, ...]]
) -> None:
    r, azimuth, elevation, rate, rcs_db = np.array(seen, np.float64).T
    towards = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    points = r[:, None] * towards
    path = tmp_path_factory.getbasetemp() / "scan.pcd"
    found = detections_ego(datum_of(path, scan(points, rate, rcs_db)))
    turn = QUARTER.rotation()
    velocities = (rate / 2)[:, None] * np.column_stack([towards[:, :2], np.zeros(len(r))]) @ turn.T
    wanted = np.column_stack([points @ turn.T + QUARTER.translation_m, rcs_db, velocities[:, :2]])
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-4)


def test_the_scan_of_an_export_lies_on_its_world(rig: Path) -> None:
    datum = frames_in(FolderFiles(rig))[0].data["RADAR_FRONT"]
    found = detections_ego(datum)
    assert len(found) > 20
    assert np.isclose(found[:, 2], 0.1, atol=1e-3).sum() > 20


def test_a_scan_that_saw_nothing_has_no_row(tmp_path: Path) -> None:
    nothing = np.zeros((0, 3))
    assert detections_ego(datum_of(tmp_path / "a.pcd", scan(nothing, nothing[:, 0], nothing[:, 0]))).shape == (0, 6)


def test_a_scan_that_says_so_itself_has_no_row(tmp_path: Path) -> None:
    content = sound().replace(b"POINTS 2", b"POINTS 0")
    assert detections_ego(datum_of(tmp_path / "a.pcd", content)).shape == (0, 6)
    head = content[: content.index(b"DATA binary\n") + 12]
    assert detections_ego(datum_of(tmp_path / "a.pcd", head)).shape == (0, 6)


def test_rows_that_are_no_place_are_left_out(tmp_path: Path) -> None:
    records = np.zeros(4, RADAR_RECORD)
    records["x"], records["y"] = [5, np.nan, 1e9, 7], [0, 0, 0, np.inf]
    content = sound()
    head = content[: content.index(b"DATA binary\n") + 12].replace(b"POINTS 2", b"POINTS 4")
    assert len(detections_ego(datum_of(tmp_path / "a.pcd", head + records.tobytes()))) == 1


def test_fields_are_found_by_name_whatever_their_order(tmp_path: Path) -> None:
    record = np.dtype(
        [("rcs", "<f8"), ("vx_comp", "<f4"), ("z", "<f4"), ("y", "<f4"), ("x", "<f4"), ("vy_comp", "<f4")]
    )
    rows = np.array([(9, 1, 0.5, 2, 3, -1)], record)
    head = "FIELDS rcs vx_comp z y x vy_comp\nSIZE 8 4 4 4 4 4\nTYPE F F F F F F\nPOINTS 1\nDATA binary\n"
    found = detections_ego(datum_of(tmp_path / "a.pcd", head.encode() + rows.tobytes(), SE3.identity()))
    assert found.tolist() == [[3, 2, 0.5, 9, 1, -1]]


def sound() -> bytes:
    return scan(np.array([[5.0, 1, 0], [6, 2, 1]]), np.array([1.0, -1]), np.array([3.0, 4]))


LIES = {
    "text": (b"DATA binary", b"DATA ascii", "it is not a binary PCD"),
    "compressed": (b"DATA binary", b"DATA binary_compressed", "it is not a binary PCD"),
    "no head": (sound(), b"", "it is not a binary PCD"),
    "more points than bytes": (b"POINTS 2", b"POINTS 9", "declares 9 detections, there are bytes for 2"),
    "fewer than none": (b"POINTS 2", b"POINTS -1", "declares -1 detections"),
    "a count that is none": (b"POINTS 2", b"POINTS two", "the header of the PCD is not valid"),
    "a count of a million digits": (b"POINTS 2", b"POINTS " + b"9" * 3000, "detections|is none"),
    "no count": (b"POINTS 2\n", b"", "the header of the PCD is not valid"),
    "a field of three bytes": (b"SIZE 4 4 4", b"SIZE 4 4 3", "the header of the PCD is not valid"),
    "a type that is none": (b"TYPE F", b"TYPE Q", "the header of the PCD is not valid"),
    "fewer types than fields": (b"TYPE F F", b"TYPE F", "the header of the PCD is not valid"),
    "a field twice": (b"FIELDS x y", b"FIELDS x x", "the header of the PCD is not valid"),
    "no velocity": (b"vx_comp", b"vx_camp", "it has no field 'vx_comp'"),
    "several values a field": (b"COUNT 1 1", b"COUNT 1 2", "several values"),
}


@pytest.mark.parametrize("lie", LIES)
def test_heads_that_lie_are_refused(lie: str, tmp_path: Path) -> None:
    old, new, why = LIES[lie]
    assert old in sound()
    with pytest.raises(DamagedExportError, match=why):
        detections_ego(datum_of(tmp_path / "a.pcd", sound().replace(old, new)))


def test_a_scan_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    datum = datum_of(tmp_path / "a.pcd", sound())
    with pytest.raises(DamagedExportError, match="bytes, at most"):
        detections_ego(replace(datum, span=replace(datum.span, size_bytes=1 << 30)))
