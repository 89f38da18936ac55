"""Compiled kernels for counting, loaded once in the process that forks children."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from services.eval.truth_pack import TruthPack, write_truth_pack
from stone.scoring.bitplanes import frame_counts, truth_planes
from stone_base.label_grid import PAPER
from stone_submissions.manifest import Manifest


@cache
def warm() -> None:
    """Load or compile the kernels before the first child, since children cannot keep compiled code (0.4 s).

    The warm-up processes a frame, so that it covers all kernels.
    """
    nothing, token = np.zeros(PAPER.shape, np.uint8), "0" * 32
    truth = truth_planes(nothing, nothing == 0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "truth.pack"
        write_truth_pack(path, Manifest({"": (token,)}), lambda _: truth, threads=1)
        with TruthPack(path) as pack:
            frame_counts(nothing, pack.planes_of(token))
