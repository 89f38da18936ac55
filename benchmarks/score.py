"""Scoring a zip, every check on, beside a plain `np.load` + `np.bincount` loop: `python -m benchmarks.score`.

Both read the same zip in the same run, taking turns, and hold the ground truth in memory. The loop sees a part of the
frames (it is slow); figures are per frame, of processor time. The two must agree on every count.
"""

import argparse
import io
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.grids import frames
from services.eval.manifest import Manifest
from services.eval.pipeline import count
from services.eval.submission_zip import Submission, open_submission
from stone.bitplanes import TruthPlanes, truth_planes
from stone.bootstrap import block_draws
from stone.confusion import mean_iou
from stone.grid import GRID_SHAPE, Grid

DISTINCT, TURNS, LOOPED = 200, 10, 20


@dataclass
class Clock:
    """Processor and wall seconds of all turns, and the frames they took."""

    frames: int = 0
    processor_s: float = 0.0
    wall_s: float = 0.0
    rates_ms: list[float] = field(default_factory=list)

    @contextmanager
    def turn(self, frames: int) -> Iterator[None]:
        processor_s, wall_s = time.process_time(), time.perf_counter()
        yield
        spent_s = time.process_time() - processor_s
        self.frames += frames
        self.processor_s += spent_s
        self.wall_s += time.perf_counter() - wall_s
        self.rates_ms.append(1e3 * spent_s / frames)

    @property
    def median_ms(self) -> float:
        return float(np.median(self.rates_ms))


@dataclass(frozen=True, eq=False)
class Material:
    """The submission on disk and the ground truth in memory, both `DISTINCT` frames over and over."""

    path: Path
    tokens: tuple[str, ...]
    planes: list[TruthPlanes]
    labels: list[Grid]

    def planes_of(self, token: str) -> TruthPlanes:
        return self.planes[int(token, 16) % len(self.planes)]

    def labels_of(self, token: str) -> Grid:
        return self.labels[int(token, 16) % len(self.planes)]


def saved_by_numpy(grid: Grid) -> bytes:
    """The file that `np.savez_compressed` writes, as most participants will."""
    file = io.BytesIO()
    np.savez_compressed(file, semantics=grid)
    return file.getvalue()


def material(path: Path, frame_count: int) -> Material:
    everywhere = np.ones(GRID_SHAPE, np.bool_)
    labels: list[Grid] = []
    files, planes = [], []
    for truth, prediction in frames(min(DISTINCT, frame_count)):
        labels += [truth] if len(labels) < LOOPED else []
        planes.append(truth_planes(truth, everywhere))
        files.append(saved_by_numpy(prediction))
    tokens = tuple(f"{index:032x}" for index in range(frame_count))
    with zipfile.ZipFile(path, "w") as archive:
        for index, token in enumerate(tokens):
            archive.writestr(f"{token}.npz", files[index % len(files)])
    return Material(path, tokens, planes, labels)


def plain_loop(archive: zipfile.ZipFile, data: Material, tokens: tuple[str, ...]) -> NDArray[np.int64]:
    """What one writes first; no check but numpy's own."""
    total = np.zeros(16, np.int64)
    for token in tokens:
        prediction = np.load(io.BytesIO(archive.read(f"{token}.npz")))["semantics"]
        pairs = data.labels_of(token).astype(np.int64) * 4 + prediction
        total += np.bincount(pairs.ravel(), minlength=16)
    return total.reshape(4, 4)


def compare(submission: Submission, archive: zipfile.ZipFile, data: Material, clocks: dict[str, Clock]) -> None:
    """Take turns; in each, the loop re-counts the first frames of ours."""
    parts = np.array_split(np.array(data.tokens), TURNS)
    kept = []
    for part in parts:
        tokens = tuple(map(str, part))
        looped = tuple(token for token in tokens if int(token, 16) % len(data.planes) < len(data.labels))[:LOOPED]
        for name, threads in (("ours, 1 thread", 1), ("ours, 2 threads", 2)):
            with clocks[name].turn(len(tokens)):
                confusions = count(submission, Manifest({"s": tokens}), data.planes_of, threads=threads)
        with clocks["np.load + np.bincount"].turn(len(looped)):
            expected = plain_loop(archive, data, looped)
        rows = [tokens.index(token) for token in looped]
        if not np.array_equal(confusions[rows].sum(axis=(0, 1)), expected):
            raise SystemExit("the counts of the two differ: the benchmark is void")
        kept.append(confusions)
    whole = np.concatenate(kept).sum(axis=1)
    lengths = [len(rows) for rows in np.array_split(whole, 5)]
    block_draws(whole[:10], [10])  # compiled before it is timed
    with clocks["10,000 block-bootstrap draws of 2"].turn(1):
        mean_iou(block_draws(np.stack([whole, whole]), lengths))


def table_of(clocks: dict[str, Clock]) -> Table:
    table = Table(title="Scoring (processor time, median of turns)")
    for column in ("what", "frames", "ms/frame", "wall ms/frame", "plain loop / this"):
        table.add_column(column, justify="left" if column == "what" else "right")
    loop_ms = clocks["np.load + np.bincount"].median_ms
    for name, clock in clocks.items():
        ratio = f"{loop_ms / clock.median_ms:.1f}" if clock.frames > 1 else ""
        wall_ms = 1e3 * clock.wall_s / clock.frames
        table.add_row(name, str(clock.frames), f"{clock.median_ms:.3f}", f"{wall_ms:.3f}", ratio)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=7000)
    frame_count = max(parser.parse_args().frames, TURNS)
    names = ("np.load + np.bincount", "ours, 1 thread", "ours, 2 threads", "10,000 block-bootstrap draws of 2")
    clocks = {name: Clock() for name in names}
    with TemporaryDirectory() as folder:
        data = material(Path(folder) / "submission.zip", frame_count)
        with open_submission(data.path, data.tokens) as submission, zipfile.ZipFile(data.path) as archive:
            count(submission, Manifest({"s": data.tokens[:1]}), data.planes_of)  # kernels compiled before timing
            start_s = time.process_time()
            open_s = 0.0
            with open_submission(data.path, data.tokens):
                open_s = time.process_time() - start_s
            compare(submission, archive, data, clocks)
        size_mb = data.path.stat().st_size / 1e6
    console = Console()
    console.print(table_of(clocks))
    console.print(f"{frame_count} frames, zip of {size_mb:.0f} MB; its directory is checked in {1e3 * open_s:.0f} ms")


if __name__ == "__main__":
    main()
