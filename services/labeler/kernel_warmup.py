"""Compiled kernels for labelling, loaded once in the process that forks children.

**Conventions.** A child cannot keep what it compiles. The stages therefore label a small run here, in the default and
the paper's profile, and draw it: this covers every kernel with the types of its use. Importing this module calls one
small kernel, after which numba's tables of types and functions are loaded (0.7 s). This is sufficient for workers that
keep what they compile. No kernel has threads, so a fork copies all of them.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import scipy.special  # noqa: F401  # loaded where it is used, which would be in every worker

from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.parameters import LabelParameters, parameters_for
from services.labeler.run import LabelRun, silent
from stone.geometry.se3 import SE3
from stone.kernels.loading import load_compiler
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from stone.sensors.sequence import Frames, Sequence, Sweep, frame_token
from stone_base.label_grid import RELEASE
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes

load_compiler()

FRAMES, PERIOD_NS, STEP_M, CUBE_CELLS = 6, 100_000_000, 0.5, 80
HEIGHT_M, EXTENT_M, SPACING_M = 1.2, 9.0, 0.15
OPTICAL = np.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 0.0])  # z forward, x right, y down


@dataclass(frozen=True)
class WarmupSweeps:
    """Sweeps of gently waving ground with a wall, which an object crosses."""

    def sweep(self, index: int) -> Sweep:
        side = np.arange(-EXTENT_M, EXTENT_M, SPACING_M)
        x, y = (plane.ravel() for plane in np.meshgrid(side, side))
        along = x + index * STEP_M
        ground = np.stack([x, y, 0.05 * np.sin(along) * np.cos(y) - HEIGHT_M], axis=1)
        wall = np.stack([np.full_like(x, 6.0 - index * STEP_M), y, 0.1 * x], axis=1)
        mover = np.stack([0.05 * x + 3.0, 0.05 * y + index - 6.0, 0.05 * x - 0.6], axis=1)
        points = np.concatenate([ground, wall[::7], mover[::29]]).astype(np.float32)
        return Sweep(index * PERIOD_NS, points)


def warmup_sequence() -> Sequence:
    """Return a straight run of `FRAMES` frames with one camera."""
    stamps_ns = np.arange(FRAMES, dtype=np.int64) * PERIOD_NS
    poses = np.tile([1.0, 0, 0, 0, 0, 0, 0], (FRAMES, 1))
    poses[:, 4] = np.arange(FRAMES) * STEP_M
    lens = CameraIntrinsics("pinhole", 64, 48, 40.0, 40.0, 32.0, 24.0)
    camera = Mount("CAM_FRONT", "camera", SE3(OPTICAL), intrinsics=lens)
    calibration = Calibration("warmup", SE3(np.array([1.0, 0, 0, 0, 0, 0, HEIGHT_M])), (camera,))
    tokens = tuple(frame_token("warmup", int(stamp)) for stamp in stamps_ns)
    return Sequence("warmup", Frames(stamps_ns, tokens, SE3(poses)), (), calibration, "odometry")


@cache
def warm() -> None:
    """Label and draw the small run once per process.

    It is labelled in the default profile with confidence, in the paper's profile, and at a grid of larger voxels.
    """
    from services.labeler.pipeline import MAP, PICTURES

    confident = replace(parameters_for(DEFAULT_PROFILE), confidence=True)
    with TemporaryDirectory(prefix="stone-warmup-") as folder:
        _label(Path(folder) / "confident", confident, without=(MAP, PICTURES))
        _label(Path(folder) / "paper", parameters_for("paper"))
        _label(Path(folder) / "release", replace(parameters_for("paper"), grids=(RELEASE,)), without=(MAP, PICTURES))


def _label(scratch: Path, parameters: LabelParameters, without: Collection[str] = ()) -> None:
    from services.labeler.pipeline import STAGES, label_graph

    scratch.mkdir()
    (scratch / SEQUENCE_FILE).write_bytes(sequence_bytes(warmup_sequence()))
    sequence = read_sequence((scratch / SEQUENCE_FILE).read_bytes())
    small = replace(parameters, tiling=replace(parameters.tiling, cube_cells=CUBE_CELLS))
    run = LabelRun(sequence, WarmupSweeps(), small, scratch)
    for job in label_graph(run):
        if job.kind in STAGES and job.kind not in without:
            STAGES[job.kind].work(run, job.arguments, silent)
