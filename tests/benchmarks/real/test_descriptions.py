"""Descriptions of real recordings: what is refused, where files are looked for, what is said where there is nothing."""

from pathlib import Path

import pytest

from benchmarks.real.description import Described, own_descriptions, read_description
from benchmarks.real.errors import DescriptionError
from stone_recordings.calibrations.file import read_calibration

RUN = "stone_real: 1\nname: yard\nabout: a yard\ncalibration: rig.yaml\nrecording: yard.mcap\n"
SCAN = RUN.replace("recording: yard.mcap", "scan: yard.bin")


def written(folder: Path, text: str, name: str = "yard") -> Path:
    path = folder / f"{name}.real.yaml"
    path.write_text(text)
    return path


def read(folder: Path, text: str) -> Described:
    return read_description(written(folder, text), folder)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (RUN + "scan: yard.bin\n", "give either `recording`, a bag, or `scan`"),
        (RUN.replace("recording: yard.mcap\n", ""), "give either `recording`, a bag, or `scan`"),
        (RUN + "tracks_m: {on: [[0, 0], [1, 0]]}\n", "`tracks_m` is for a scan"),
        (SCAN + "tracks_m: {on: [[0, 0]]}\n", "tracks_m.on: "),
        (RUN + "flat_m: [[[0, 0], [1, 0]]]\n", "flat_m.0: "),
        (RUN + "walls_m: [[[0, .nan], [1, 0]]]\n", "walls_m.0.0.1: "),
        (RUN + "walls_m: [[[0, 1e9], [1, 0]]]\n", "walls_m.0.0.1: "),
        (RUN + "flat_beside_track_m: 400\n", "flat_beside_track_m: "),
        (RUN + "passes: [thirds]\n", "passes.0: "),
        (RUN + "walls: []\n", "walls: Extra inputs"),
        (RUN.replace("yard\nabout", "../yard\nabout"), "name: "),
        (RUN.replace("real: 1", "real: 2"), "stone_real: "),
        (RUN + "semantics: {scans: [], ground: {grass: 3}, obstacle: {tree: 4}}\n", "semantics.scans: "),
        (
            RUN + "semantics: {scans: [{points: a, labels: b}], ground: {grass: 3}, obstacle: {tree: 4}}\n",
            "a needs `stamp_ns`",
        ),
        ("transforms: 1\n---\ntransforms: 2\n", "holds 2 documents"),
        ("[]", "the whole: "),
    ],
)
def test_a_description_that_cannot_be_followed_is_refused_by_field(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(DescriptionError) as refused:
        read(tmp_path, text)
    assert problem in str(refused.value)
    assert str(refused.value).startswith("yard.real.yaml: ")


def test_the_projects_own_descriptions_can_be_read_and_so_can_their_calibrations(tmp_path: Path) -> None:
    assert len(own_descriptions()) >= 2
    for path in own_descriptions():
        described = read_description(path, tmp_path)
        read_calibration(described.file(described.description.calibration))
