"""Rows trained on some worlds, scored on one that they have not seen: `python -m benchmarks.models.unseen`.

Each row is trained with each seed on worlds 1, 2 and 3, with no look at world 4, and predicts every tenth frame of that
through `stone predict`'s own code. It is scored on the voxels of its lattice, the 25.6 m around the robot, all of them,
as a benchmark that masks nothing scores, and so is `stone baseline` on the same voxels. Cameras, LiDAR and radar
are simulated. CPU-seconds are of training alone, one thread. Worlds, runs and figures are kept in `--folder`, and what
is there is not made again. The interval is Student's of the seeds' difference from the baseline.
"""

import argparse
import json
import shutil
import statistics
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.stats import t

from baselines.cache import cached_frames
from baselines.lattice import VoxelLattice, grid_part
from baselines.metrics import scores_of
from baselines.predict import PredictionPlan, predict
from baselines.row_config import read_row
from baselines.sources import labelled_frames
from baselines.train import TrainingPlan, train
from benchmarks.models.worlds import ModelWorld, made_world
from stone_client.server.baseline import BaselinePlan, write_baseline

ROWS = ("l-conet-small", "occfusion-cl-small", "column-net-small")
TRAINED, UNSEEN = (1, 2, 3), 4
SECONDS, EVERY = 15.0, 10
PART = VoxelLattice((-12.8, -12.8, -2.0), (0.2, 0.2, 0.2), (128, 128, 32))
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")


@dataclass(frozen=True)
class UnseenScores:
    """Of one row and seed on the world that it has not seen. Times are CPU-seconds, of training and of a frame."""

    row: str
    seed: int
    ratios: Mapping[str, float | None]
    training_s: float = 0.0
    steps: int = 0
    frame_s: float = 0.0


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--folder", type=Path, default=Path("build/models"))
    arguments.add_argument("--rows", nargs="+", default=list(ROWS))
    arguments.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    options = arguments.parse_args()
    torch.set_num_threads(1)
    worlds = {seed: made_world(options.folder, seed, SECONDS, EVERY) for seed in (*TRAINED, UNSEEN)}
    geometric = baseline_scores(worlds[UNSEEN])
    runs = [
        kept(options.folder / f"{row}-{seed}.json", row, seed, worlds) for row in options.rows for seed in options.seeds
    ]
    Console(width=140).print(table_of(geometric, runs))


def kept(path: Path, row: str, seed: int, worlds: Mapping[int, ModelWorld]) -> UnseenScores:
    """The scores in the file, or measured and put there."""
    if not path.exists():
        path.write_text(json.dumps(asdict(trained_scores(path.with_suffix(""), row, seed, worlds))), "utf-8")
    return UnseenScores(**json.loads(path.read_text("utf-8")))


def trained_scores(run: Path, row: str, seed: int, worlds: Mapping[int, ModelWorld]) -> UnseenScores:
    """Train the row on what is to be trained on, and score it on what is not."""
    exports = tuple(worlds[world].export for world in TRAINED)
    config = read_row(row, {"seed": seed})
    cache = run.parent / "frames"
    cached_frames(labelled_frames(exports), config.inputs, cache, _silent)  # not counted as training
    begun = time.process_time()
    shutil.rmtree(run, ignore_errors=True)
    ended = train(TrainingPlan(config, exports, run, cache=cache), _silent, lambda report: None)
    training_s = time.process_time() - begun
    begun = time.process_time()
    zipped, unseen = run.with_suffix(".zip"), worlds[UNSEEN]
    written = predict(PredictionPlan(run, (unseen.export,), unseen.manifest, zipped), _silent)
    frame_s = (time.process_time() - begun) / written.frames
    return UnseenScores(row, seed, ratios_of(zipped, unseen, config.model.lattice), training_s, ended.steps, frame_s)


def baseline_scores(world: ModelWorld) -> UnseenScores:
    """`stone baseline` on the same frames."""
    zipped = world.folder / "baseline.zip"
    begun = time.process_time()
    written = write_baseline([world.export], BaselinePlan(world.manifest, zipped, 1), _silent)
    frame_s = (time.process_time() - begun) / written.frames
    return UnseenScores("baseline", 0, ratios_of(zipped, world, PART), frame_s=frame_s)


def ratios_of(submission: Path, world: ModelWorld, lattice: VoxelLattice) -> Mapping[str, float | None]:
    """Of the frames of a submission, over the part of their grids that the lattice covers."""
    part, whole = grid_part(lattice), np.zeros((4, 4), np.int64)
    for labels in sorted(world.ground_truth.rglob("labels.npz")):
        truth, predicted = classes_of(labels, "semantics"), _submitted(submission, labels.parent.name)
        cells = truth[part].astype(np.int64) * 4 + predicted[part]
        whole += np.bincount(cells.reshape(-1), minlength=16).reshape(4, 4)
    scores: Mapping[str, float | None] = scores_of(whole)
    return scores


def classes_of(file: Path | BytesIO, key: str) -> NDArray[np.uint8]:
    with np.load(file) as arrays:
        classes: NDArray[np.uint8] = arrays[key]
    return classes


def _submitted(submission: Path, token: str) -> NDArray[np.uint8]:
    with zipfile.ZipFile(submission) as archive:
        return classes_of(BytesIO(archive.read(f"{token}.npz")), "semantics")


def table_of(geometric: UnseenScores, runs: Sequence[UnseenScores]) -> Table:
    """A line a row: means over seeds in per cent, and by how much mIoU is above the baseline's."""
    table = Table(title=f"world {UNSEEN}, every tenth frame; trained on worlds {', '.join(map(str, TRAINED))}")
    for heading in ("row", "seeds", *RATIOS, "mIoU above", "CPU-s to train", "steps", "CPU-s a frame"):
        table.add_column(heading, justify="left" if heading == "row" else "right")
    shown = [_percent([geometric.ratios[name]]) for name in RATIOS]
    table.add_row("baseline", "", *shown, "", "", "", _mean_of([geometric.frame_s]))
    for row in dict.fromkeys(run.row for run in runs):
        own = [run for run in runs if run.row == row]
        above = [_value(run, "miou") - _value(geometric, "miou") for run in own]
        table.add_row(
            row,
            str(len(own)),
            *(_percent([run.ratios[name] for run in own]) for name in RATIOS),
            interval_of(above),
            _mean_of([run.training_s for run in own]),
            str(own[0].steps),
            _mean_of([run.frame_s for run in own]),
        )
    return table


def interval_of(values: Sequence[float]) -> str:
    """Mean and 95 % interval, in per cent."""
    mean = statistics.mean(values)
    if len(values) < 2:
        return f"{100 * mean:+.2f}"
    reach = t.ppf(0.975, len(values) - 1) * statistics.stdev(values) / len(values) ** 0.5
    return f"{100 * mean:+.2f} ± {100 * reach:.2f}"


def _value(run: UnseenScores, name: str) -> float:
    return run.ratios[name] or 0.0


def _percent(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{100 * statistics.mean(known):.2f}" if known else "–"


def _mean_of(values: Sequence[float]) -> str:
    return f"{statistics.mean(values):.2f}"


def _silent(stage: str, done: int, total: int) -> None:
    """No progress wanted."""


if __name__ == "__main__":
    main()
