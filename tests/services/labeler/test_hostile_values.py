"""Whatever values a stranger records, it is refused with a code or labelled: no crash, no number that is none.

Every day those that are refused; of those that are labelled two every day, six with `make check`, and the others before
a release: they alone catch a crash or a number that is none by their own value. `make fuzz` looks for further ones.
"""

import json
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzz.labels import labelled, read_and_label
from fuzz.limits import OF_LABELLING, check
from services.labeler.report import LabelReport
from stone.errors import StoneError
from stone.sensors.reach import FARTHEST_POINT_M
from testing.worlds.hostile_drive import ATTACKS, attacked, edit_bytes, write_drive

STONE = Path(sys.executable).parent / "stone"
OVERFLOWING = "points that overflow as they are turned"
REFUSED = {
    "heights below what a number holds": "footprint_off_ground",
    "every position 1e9": "MSG-305",
    "every position 1e300": "MSG-305",
    "every quaternion of zeros": "MSG-305",
    "quaternions of 1e300": "MSG-305",
    "quaternions of 5e-324": "MSG-305",
    "cloud stamps at the beginning of time": "SYN-501",
    "recorded at both ends": "BAG-012",
    "recorded beyond int64": "BAG-012",
    "clouds of 4 billion points": "TOP-101",
    "a mount beyond the map": "CAL-409",
    "a mount at the end of its limit": "CAL-409",
    "a mount turned by nothing": "CAL-402",
    "a mount turned by infinity": "CAL-416",
    "a footprint without end": "CAL-415",
    "a negative footprint": "CAL-415",
    "a robot around all of its points": "no_reference",
}
LABELLED = ATTACKS.keys() - REFUSED.keys()
TIERS = dict.fromkeys((OVERFLOWING, "pose stamps at both ends"), ()) | dict.fromkeys(
    (
        "half of the points infinite",
        "one position 1e300",
        "one quaternion NaN",
        "point times at the end of int64",
        "a point of no bytes",
        "rings of 65535",
    ),
    pytest.mark.whole,
)


def made(name: str, folder: Path) -> LabelReport:
    """The labels of an attack; a calculation that numpy warns of is a fault."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        return labelled(attacked(*ATTACKS[name]), folder)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_labelled_is_refused_with_its_code(tmp_path: Path, name: str) -> None:
    with pytest.raises(StoneError) as refused:
        made(name, tmp_path)
    assert refused.value.code == REFUSED[name]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=TIERS.get(name, pytest.mark.release)) for name in sorted(LABELLED)]
)
def test_what_can_be_labelled_has_labels_that_are_numbers(tmp_path: Path, name: str) -> None:
    report = made(name, tmp_path)
    assert len(report.sequence.frames) > 0
    said = {finding.code for finding in report.findings}
    far = any(edit.array == "points" and 1000 < abs(edit.value) < np.inf for edit in ATTACKS[name])
    assert ("LAB-608" in said, report.far.points > 0) == (far, far)


@pytest.mark.whole
def test_points_that_no_lidar_sees_change_no_label_and_are_counted(tmp_path: Path) -> None:
    """Beside a drive in which the same points are not there at all."""
    lost = tuple(replace(edit, value=np.nan) for edit in ATTACKS[OVERFLOWING])
    folders = [tmp_path / "hostile", tmp_path / "lost"]
    for folder in folders:
        folder.mkdir()
    reports = [labelled(attacked(*ATTACKS[OVERFLOWING]), folders[0]), labelled(attacked(*lost), folders[1])]
    assert (reports[0].far.points, reports[0].far.sweeps, reports[0].far.read) == (512, 1, 8)
    assert reports[1].far.points == 0
    found = next(finding for finding in reports[0].findings if finding.code == "LAB-608")
    assert found.severity == "warning"
    assert found.message.startswith(f"512 points in 1 of 8 sweeps are farther than {FARTHEST_POINT_M:g} m")
    packs = [sorted((folder / "scratch" / "packs").glob("*.pack")) for folder in folders]
    assert packs[0]
    assert [path.read_bytes() for path in packs[0]] == [path.read_bytes() for path in packs[1]]


@pytest.mark.whole
def test_the_command_labels_the_recording_that_killed_it(tmp_path: Path) -> None:
    """Catches alone what the command's own processes make of it: one of them was killed by SIGBUS."""
    bag, calibration = write_drive(attacked(*ATTACKS[OVERFLOWING]), tmp_path)
    command = [STONE, "label", bag, "--calibration", calibration, "-o", tmp_path / "out", "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert ended.returncode == 0, ended.stderr[-2000:]
    record = json.loads(ended.stdout)
    assert (record["frames"], record["map"]["far_points"]) == (8, 512)
    assert "LAB-608" in {finding["code"] for finding in record["findings"]}
    assert "Traceback" not in ended.stderr


@pytest.mark.whole
def test_maps_far_apart_cost_no_picture_of_all_between() -> None:
    """Catches alone a picture with a pixel for every voxel between them: terabytes at 100 km.

    2 GiB at 1.5 km are a found case of `tests/fuzz/`.
    """
    read_and_label(b"")  # what is compiled for any drive is no cost of this one
    check(read_and_label, edit_bytes(*ATTACKS["poses that go 100 km away and come back"]), OF_LABELLING)
