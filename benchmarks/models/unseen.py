"""Rows trained on some worlds, scored on unseen worlds: `python -m benchmarks.models.unseen`.

Each row is trained with each seed on worlds 1, 2 and 3 only, and predicts every tenth frame of worlds 4, 6, 7 and 8
with `stone model predict`'s own code. (World 5 was used to choose between variants of ColumnNet.) All voxels of its
lattice, the 25.6 m around the robot, are scored, like in a benchmark without a mask; `stone baseline` is scored on the
same voxels. Cameras, LiDAR and radar are simulated. CPU-seconds are of training alone, one thread. Worlds, runs and
figures are stored in `--folder` and reused. Intervals are Student's, for the seeds' differences from the baseline over
all worlds, and for the worlds' differences between two rows (means of seeds).
"""

import argparse
import json
import shutil
import statistics
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
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
from baselines.metrics import class_confusion, scores_of
from baselines.predict import PredictionPlan, predict
from baselines.row_config import read_row
from baselines.sources import labelled_frames
from baselines.train import TrainingPlan, train
from benchmarks.models.worlds import ModelWorld, made_world
from stone.scoring.metric import CLASSES
from stone_base.label_grid import PAPER
from stone_client.baseline import BaselinePlan, write_baseline

ROWS = ("l-conet-small", "occfusion-cl-small", "column-net-small")
TRAINED, UNSEEN = (1, 2, 3), (4, 6, 7, 8)
SECONDS, EVERY = 15.0, 10
PART = VoxelLattice((-12.8, -12.8, -2.0), (0.2, 0.2, 0.2), (128, 128, 32))
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")


@dataclass(frozen=True)
class UnseenScores:
    """The scores of one row and seed, by unseen world. Times are CPU-seconds, of training and per frame."""

    row: str
    seed: int
    confusions: Mapping[str, Sequence[Sequence[int]]]
    training_s: float = 0.0
    steps: int = 0
    frame_s: float = 0.0

    def ratio(self, name: str, world: str | None = None) -> float:
        """Return the ratio of one world, or of all worlds' voxels together."""
        chosen = [self.confusions[world]] if world else list(self.confusions.values())
        return scores_of(np.sum([np.array(counts) for counts in chosen], axis=0))[name] or 0.0


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--folder", type=Path, default=Path("build/models"))
    arguments.add_argument("--rows", nargs="+", default=list(ROWS))
    arguments.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    options = arguments.parse_args()
    torch.set_num_threads(1)
    worlds = {seed: made_world(options.folder, seed, SECONDS, EVERY) for seed in (*TRAINED, *UNSEEN)}
    geometric = baseline_scores([worlds[seed] for seed in UNSEEN])
    runs = [
        kept(options.folder / f"{row}-{seed}.json", row, seed, worlds) for row in options.rows for seed in options.seeds
    ]
    Console(width=140).print(table_of(geometric, runs), worlds_table(geometric, runs))


def kept(path: Path, row: str, seed: int, worlds: Mapping[int, ModelWorld]) -> UnseenScores:
    """Return the scores in the file; measure and store them if it is missing."""
    if not path.exists():
        path.write_text(json.dumps(asdict(trained_scores(path.with_suffix(""), row, seed, worlds))), "utf-8")
    return UnseenScores(**json.loads(path.read_text("utf-8")))


def trained_scores(run: Path, row: str, seed: int, worlds: Mapping[int, ModelWorld]) -> UnseenScores:
    """Train the row on the training worlds, and score it on the unseen worlds."""
    exports = tuple(worlds[world].export for world in TRAINED)
    config = read_row(row, {"seed": seed})
    cache = run.parent / "frames"
    cached_frames(labelled_frames(exports), config.inputs, cache, _silent)  # not counted as training
    begun = time.process_time()
    shutil.rmtree(run, ignore_errors=True)
    ended = train(TrainingPlan(config, exports, run, cache=cache), _silent, lambda report: None)
    training_s = time.process_time() - begun

    def write(world: ModelWorld, zipped: Path) -> int:
        frames: int = predict(PredictionPlan(run, (world.export,), world.manifest, zipped), _silent).frames
        return frames

    unseen = [worlds[world] for world in UNSEEN]
    confusions, frame_s = judged(run, unseen, config.model.lattice, write)
    return UnseenScores(row, seed, confusions, training_s, ended.steps, frame_s)


def baseline_scores(worlds: Sequence[ModelWorld]) -> UnseenScores:
    """Return the scores of `stone baseline` on the same frames."""
    run = worlds[0].folder.parent / "baseline"
    run.mkdir(exist_ok=True)

    def write(world: ModelWorld, zipped: Path) -> int:
        return write_baseline([world.export], BaselinePlan(world.manifest, zipped, 1), _silent).frames

    confusions, frame_s = judged(run, worlds, PART, write)
    return UnseenScores("baseline", 0, confusions, frame_s=frame_s)


def judged(
    run: Path, worlds: Sequence[ModelWorld], lattice: VoxelLattice, write: Callable[[ModelWorld, Path], int]
) -> tuple[dict[str, list[list[int]]], float]:
    """Return confusions by world of the submissions, and CPU-seconds per frame; `write` writes one and returns its
    frames.
    """
    submissions = [run / f"{world.folder.name}.zip" for world in worlds]
    begun = time.process_time()
    frames = sum(map(write, worlds, submissions))
    frame_s = (time.process_time() - begun) / frames
    confusions = {
        world.folder.name: confusion_in(zipped, world, lattice).tolist()
        for world, zipped in zip(worlds, submissions, strict=True)
    }
    return confusions, frame_s


def confusion_in(submission: Path, world: ModelWorld, lattice: VoxelLattice) -> NDArray[np.int64]:
    """Return the confusion of a submission's frames, over the part of their grids inside the lattice."""
    part, whole = grid_part(lattice, PAPER), np.zeros((CLASSES, CLASSES), np.int64)
    for labels in sorted(world.ground_truth.rglob("labels.npz")):
        truth, predicted = classes_of(labels, "semantics"), _submitted(submission, labels.parent.name)
        whole += class_confusion(torch.from_numpy(predicted[part]), torch.from_numpy(truth[part]))
    return whole


def classes_of(file: Path | BytesIO, key: str) -> NDArray[np.uint8]:
    with np.load(file) as arrays:
        classes: NDArray[np.uint8] = arrays[key]
    return classes


def _submitted(submission: Path, token: str) -> NDArray[np.uint8]:
    with zipfile.ZipFile(submission) as archive:
        return classes_of(BytesIO(archive.read(f"{token}.npz")), "semantics")


def table_of(geometric: UnseenScores, runs: Sequence[UnseenScores]) -> Table:
    """Return a table with a line per row: means over seeds in per cent, and the mIoU difference from the baseline."""
    table = Table(title=f"worlds {_named(UNSEEN)}, every tenth frame; trained on worlds {_named(TRAINED)}")
    for heading in ("row", "seeds", *RATIOS, "mIoU above", "CPU-s to train", "steps", "CPU-s a frame"):
        table.add_column(heading, justify="left" if heading == "row" else "right")
    shown = [f"{100 * geometric.ratio(name):.2f}" for name in RATIOS]
    table.add_row("baseline", "", *shown, "", "", "", f"{geometric.frame_s:.2f}")
    for row, own in by_row(runs).items():
        table.add_row(
            row,
            str(len(own)),
            *(f"{100 * statistics.mean(run.ratio(name) for run in own):.2f}" for name in RATIOS),
            interval_of([run.ratio("miou") - geometric.ratio("miou") for run in own]),
            f"{statistics.mean(run.training_s for run in own):.0f}",
            str(own[0].steps),
            f"{statistics.mean(run.frame_s for run in own):.2f}",
        )
    return table


def worlds_table(geometric: UnseenScores, runs: Sequence[UnseenScores]) -> Table:
    """Return mIoU in per cent by world, means over seeds, and each row's differences from the first row over worlds."""
    names, rows = list(geometric.confusions), {"baseline": [geometric], **by_row(runs)}
    by_world = {
        row: [statistics.mean(run.ratio("miou", name) for run in own) for name in names] for row, own in rows.items()
    }
    first = next(iter(by_row(runs)))
    table = Table("row", *names, f"above {first}", title="mIoU by world")
    for row, values in by_world.items():
        above = [own - other for own, other in zip(values, by_world[first], strict=True)]
        table.add_row(row, *(f"{100 * value:.2f}" for value in values), "" if row == first else interval_of(above))
    return table


def by_row(runs: Sequence[UnseenScores]) -> dict[str, list[UnseenScores]]:
    return {row: [run for run in runs if run.row == row] for row in dict.fromkeys(run.row for run in runs)}


def interval_of(values: Sequence[float]) -> str:
    """Return the mean and the 95 % interval, in per cent."""
    mean = statistics.mean(values)
    if len(values) < 2:
        return f"{100 * mean:+.2f}"
    reach = t.ppf(0.975, len(values) - 1) * statistics.stdev(values) / len(values) ** 0.5
    return f"{100 * mean:+.2f} ± {100 * reach:.2f}"


def _named(worlds: Sequence[int]) -> str:
    return ", ".join(map(str, worlds))


def _silent(stage: str, done: int, total: int) -> None:
    """Default progress function; does nothing."""


if __name__ == "__main__":
    main()
