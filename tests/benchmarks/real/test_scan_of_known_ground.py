"""A whole run of the program over a folder: a scan cast on a plane with a wall, whose points have classes.

Catches alone that a description, its scan and the labels are in one frame, and that the table says so.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.__main__ import main

pytestmark = pytest.mark.whole

HEIGHT_M, WALL_M = 1.2, 8.0
GRASS, FENCE = 3, 18
DESCRIPTION = f"""
stone_real: 1
name: plane
about: a plane before a wall
scan: scan.bin
calibration: rig.yaml
tracks_m: {{ahead: [[0, 0], [6, 0]]}}
flat_m: [[[2, -3], [7, -3], [7, 3], [2, 3]]]
walls_m: [[[{WALL_M}, -4], [{WALL_M}, 4]]]
semantics:
  scans: [{{points: scan.bin, labels: scan.label}}]
  ground: {{grass: {GRASS}}}
  obstacle: {{fence: {FENCE}}}
"""
RIG = f"""
stone_calibration: 1
name: rig
footprint: {{length_m: 1.0, width_m: 0.8}}
ego_from_lidar: {{translation_m: [0, 0, {HEIGHT_M}], rotation_wxyz: [0, 0, 0, 1]}}
sensors: {{}}
"""


def cast() -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 4) in a LiDAR that looks back, and their classes (N,): 128 rings on the plane and the wall ahead."""
    rng = np.random.default_rng(2)
    azimuth, elevation = np.meshgrid(np.deg2rad(np.arange(0, 360, 0.25)), np.deg2rad(np.linspace(-30, 15, 128)))
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    with np.errstate(divide="ignore"):
        to_ground = np.where(z < 0, -HEIGHT_M / z, np.inf)
        to_wall = np.where(x > 0, WALL_M / x, np.inf)
    range_m = np.minimum(to_ground, to_wall)
    is_hit = (range_m < 40) & ((to_ground < to_wall) | (range_m * z < 2.0))
    noisy = np.where(is_hit, range_m + 0.01 * rng.standard_normal(range_m.shape), 0.0)
    kinds = np.where(to_ground < to_wall, GRASS, FENCE)
    points = np.stack([-noisy * x, -noisy * y, noisy * z, np.zeros_like(x)], axis=-1)
    return points.reshape(-1, 4), kinds.ravel()


@pytest.mark.release
def test_a_plane_before_a_wall_is_told_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches alone a figure of `make bench-real` that takes a wall for ground."""
    points, kinds = cast()
    points.astype("<f4").tofile(tmp_path / "scan.bin")
    kinds.astype("<u4").tofile(tmp_path / "scan.label")
    (tmp_path / "plane.real.yaml").write_text(DESCRIPTION)
    (tmp_path / "rig.yaml").write_text(RIG)
    monkeypatch.setattr("sys.argv", ["real", str(tmp_path), "--profiles", "local", "--out", str(tmp_path / "out")])
    main()
    printed = capsys.readouterr()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.out.splitlines() if "|" in line]
    head, _, refused, ahead = table[:4]
    assert refused[:3] == ["local", "footprint alone", "refused: no_reference"]
    found = dict(zip(head, ahead, strict=True))
    assert found["option"] == "track: ahead"
    assert percent(found["ground upside down"]) == 0
    assert 30 < percent(found["T under the track"]) < 90  # of 6.5 m: what is nearer than 2.1 m is never seen
    assert percent(found["N on flat ground"]) < 10
    assert percent(found["N on walls"]) == 100
    assert percent(found["T ∪ P on ground"]) > 80
    assert percent(found["N on obstacles"]) > 98
    assert "no_reference" in printed.err


def percent(cell: str) -> float:
    return float(cell.removesuffix("%"))
