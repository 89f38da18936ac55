"""What the labeler refuses, and that a run which ends early leaves nothing behind."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from services.labeler.errors import NoUsableFramesError
from services.labeler.local_run import LabelOptions, label
from stone.labels.traversability import NoReferenceError
from stone.sensors.sequence import ExcludedFrame
from stone_files.errors import OutputExistsError
from tests.services.labeler.worlds import RayCast, World, sequence_of

ROOT = Path(__file__).resolve().parents[3]
WORLD = World(grade=(0.06, 0.02))
LEFT_OUT = (
    ExcludedFrame(1_759_999_999_000_000_000, "pose_gap", "no pose within 250 ms"),
    ExcludedFrame(1_760_000_000_050_000_000, "no_pose", "the odometry had not begun"),
)


def labelled(world, folder, workers=1, **options):
    sequence = replace(sequence_of(world), excluded=LEFT_OUT)
    return label(sequence, RayCast(world), folder, LabelOptions(workers=workers, **options))


def test_an_earlier_label_set_is_replaced_and_a_foreign_folder_is_refused(tmp_path):
    world = replace(WORLD, frames=2, boxes=())
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputExistsError, match="a folder that is not empty; choose another"):
        labelled(world, tmp_path / "home")
    assert [path.name for path in (tmp_path / "home").iterdir()] == ["thesis.txt"]
    (tmp_path / "earlier" / "gts" / "old").mkdir(parents=True)
    (tmp_path / "earlier" / "report.json").write_text("{}")
    labelled(world, tmp_path / "earlier")
    assert [path.name for path in (tmp_path / "earlier" / "gts").iterdir()] == ["small"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["earlier", "home"]


def test_a_sequence_without_usable_frames_is_refused(tmp_path):
    sequence = replace(sequence_of(replace(WORLD, frames=1)), excluded=LEFT_OUT)
    none = replace(sequence.frames, stamps_ns=sequence.frames.stamps_ns[:0], tokens=())
    empty = replace(sequence, frames=replace(none, map_from_ego=none.map_from_ego[:0]))
    with pytest.raises(NoUsableFramesError, match=r"all 2 were excluded \(no_pose, pose_gap\)"):
        label(empty, RayCast(WORLD), tmp_path / "out")
    with pytest.raises(NoUsableFramesError, match="it has no LiDAR sweep"):
        label(replace(empty, excluded=()), RayCast(WORLD), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_track_that_touches_no_surface_leaves_no_folder(tmp_path):
    world = replace(WORLD, frames=2, boxes=())
    sequence = sequence_of(world)
    footless = replace(sequence.calibration, footprint=replace(sequence.calibration.footprint, width_m=0.0))
    with pytest.raises(NoReferenceError, match="the track covers 0 surface voxels"):
        label(replace(sequence, calibration=footless), RayCast(world), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_saw_nothing_is_refused(tmp_path):
    with pytest.raises(NoReferenceError, match="the track covers 0 surface voxels"):
        labelled(replace(WORLD, frames=2, reach_m=0.0), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_worker_that_fails_leaves_no_folder(tmp_path):
    with pytest.raises(RuntimeError, match="this sweep cannot be read"):
        labelled(replace(WORLD, frames=4, breaks_at=2), tmp_path / "out", workers=2)
    assert list(tmp_path.iterdir()) == []


SCRIPT = """
import sys
from pathlib import Path
from services.labeler.local_run import label
from tests.services.labeler.worlds import RayCast, World, sequence_of

def shown(stage, done, total):
    print(stage, done, flush=True)

if __name__ == "__main__":
    world = World(frames=6)
    label(sequence_of(world), RayCast(world), Path(sys.argv[1]), progress=shown)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_killing_the_run_leaves_no_output_folder(tmp_path, number):
    (tmp_path / "run.py").write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(tmp_path / "run.py"), str(tmp_path / "out")]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        begun = next(line for line in run.stdout if line.startswith("surface"))
        assert begun == "surface 0\n"
        run.send_signal(number)
        run.stdout.close()
        assert run.wait(300) in (128 + number, -number)
    assert not (tmp_path / "out").exists()
    left = [path for path in tmp_path.iterdir() if path.name != "run.py"]
    assert (left == []) == (number == signal.SIGTERM)  # kill −9 leaves a hidden staging folder for the next run
    assert all(path.name.startswith(".out.") for path in left)
