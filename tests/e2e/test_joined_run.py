"""The simulated rig in three files, with clocks 80 ms apart, is labelled as it is in one.

Catches alone what a user of several files would see wrong though each part is right: the sign of an offset from file to
label, a file that no worker may read, an input that no recipe names.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simulator.pipeline import calibration_path
from stone_files.bag_fingerprint import recording_sha256
from testing.worlds.drives import OF_THREE_CLOCKS, THREE_CLOCKS, drive
from testing.worlds.recording_parts import split_into

STONE = Path(sys.executable).parent / "stone"
LIMIT_NS = 2_000_000
pytestmark = pytest.mark.whole


def stone(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([STONE, *arguments], check=False, capture_output=True, text=True, timeout=600)


def labelled(out: Path, calibration: Path, *bags: Path) -> Mapping[str, Any]:
    done = stone("label", *bags, "--calibration", calibration, "-o", out, "--workers", "2", "--json")
    assert done.returncode == 0, done.stderr
    report: Mapping[str, Any] = json.loads(done.stdout)
    return report


def labels(out: Path) -> dict[str, bytes]:
    return {str(file.relative_to(out)): file.read_bytes() for file in sorted(out.rglob("labels.npz"))}


@pytest.mark.release
def test_three_files_with_clocks_of_their_own_give_the_labels_of_one(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Catches alone a joined run whose labels differ from those of its one file.

    Byte for byte with offsets known to 2 ms: no label asks when a picture was taken to the microsecond.
    """
    whole = drive(tmp_path_factory, THREE_CLOCKS)
    calibration = calibration_path(whole)
    paths = split_into(whole, tmp_path, OF_THREE_CLOCKS)
    one = labelled(tmp_path / "one", calibration, whole)
    three = labelled(tmp_path / "three", calibration, *paths)

    assert labels(tmp_path / "three") == labels(tmp_path / "one") != {}
    told = {recording["name"]: recording for recording in three["recordings"]}
    for part in OF_THREE_CLOCKS[1:]:
        apart_ns = told[part.name]["offset_ns"] + part.ahead_ns
        assert abs(apart_ns) < LIMIT_NS
        assert abs(apart_ns) < 4 * told[part.name]["sigma_ns"]
    assert one["recordings"] == []

    assert {part.name for part in OF_THREE_CLOCKS} < set(three["inputs"])
    assert three["inputs"]["radars.bag"] == recording_sha256(paths[2])
    named = {finding["topic"] for finding in three["findings"] if finding["code"] == "SYN-520"}
    assert named == {"cameras.mcap", "radars.bag"}

    shown = stone("inspect", *paths, "--calibration", calibration, "--json")
    assert json.loads(shown.stdout)["recordings"] == three["recordings"]
    with np.load(tmp_path / "three" / "sequence.npz") as arrays:
        assert b"cameras.mcap" in arrays["record"].tobytes()
