"""Speed and memory of scoring a zip compared with other implementations: `python -m benchmarks.score`.

All read the same zip in the same run, taking turns; slow implementations read a part of the frames. Figures are
milliseconds of processor time per frame, medians of the turns, and wall time on two threads. All must agree on every
count.
"""

import argparse
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.score.material import Material, material
from benchmarks.score.peers import ByteMoving, Plain, occ3d
from services.eval.examination import CountedFrames, TruthOf, count_range, sampled_tokens
from services.eval.truth_pack import TruthPack
from stone.scoring.confusion import named_ratios
from stone.scoring.metric import METRIC_VERSION, METRICS
from stone.scoring.score_record import interval_record, spectra_of
from stone_base.label_grid import GRIDS
from stone_submissions.archive import SubmissionZip, open_submission

TURNS, LOOPED = 10, 4
OURS, OURS_2 = "ours, 1 thread", "ours, 2 threads"
PACKED, PACKED_2 = "ours from the kept pack, 1 thread", "ours from the kept pack, 2 threads"
OCC3D, PLAIN, LIMIT = "(a) np.load, masked, bincount, as Occ3D", "(b) np.load + bincount", "(c) moving the bytes"
INTERVALS = "all intervals, once"
NAMES = (OURS, OURS_2, PACKED, PACKED_2, OCC3D, PLAIN, LIMIT, INTERVALS)
# (subject, reference, comparison, bound)
EXPECTED = ((OCC3D, "at least", 50.0), (PLAIN, "at least", 18.0), (LIMIT, "at most", 3.2))
MOST_MEMORY_BYTES = 400e6


@dataclass
class ScoreTimes:
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
class ScoreInputs:
    """The open submission, pack and peers of one measurement."""

    data: Material
    submission: SubmissionZip
    archive: zipfile.ZipFile
    pack: TruthPack
    plain: Plain
    moving: ByteMoving

    def count(self, tokens: Sequence[str], truth_of: TruthOf, threads: int) -> CountedFrames:
        sampled = sampled_tokens(self.data.tokens)
        counted = count_range(self.submission, tokens, truth_of, sampled=sampled, threads=threads)
        if counted.problems or self.submission.problems:
            raise SystemExit("the submission was refused: the benchmark is void")
        return counted


def take_turns(opened: ScoreInputs, clocks: dict[str, ScoreTimes]) -> NDArray[np.int32]:
    """Return the confusions of all frames."""
    data, kept = opened.data, []
    unpacked = ((OURS, data.planes_of, 1), (OURS_2, data.planes_of, 2))
    ours = (*unpacked, (PACKED, opened.pack.planes_of, 1), (PACKED_2, opened.pack.planes_of, 2))
    for part in np.array_split(np.array(data.tokens), TURNS):
        tokens = tuple(map(str, part))
        counts = []
        for name, truth_of, threads in ours:
            with clocks[name].turn(len(tokens)):
                counts.append(opened.count(tokens, truth_of, threads).confusions)
            with clocks[LIMIT].turn(len(tokens)):
                opened.moving(data, tokens)
        with clocks[OCC3D].turn(LOOPED):
            slow = occ3d(opened.archive, data, tokens[:LOOPED])
        with clocks[PLAIN].turn(LOOPED):
            plain = opened.plain(opened.archive, tokens[:LOOPED])
        totals = [confusions[:LOOPED].sum(axis=(0, 1)) for confusions in counts] + [plain]
        if not all(np.array_equal(total, slow) for total in totals):
            raise SystemExit("the counts differ: the benchmark is void")
        kept.append(counts[0])
    return np.concatenate(kept)


def measure(data: Material, clocks: dict[str, ScoreTimes]) -> float:
    """Fill the clocks; return the seconds to open the zip."""
    looped = [str(part[k]) for part in np.array_split(np.array(data.tokens), TURNS) for k in range(LOOPED)]
    with (
        TruthPack(data.pack_path) as pack,
        open_submission(data.zip_path, data.tokens, data.grid) as submission,
        zipfile.ZipFile(data.zip_path) as archive,
    ):
        opened = ScoreInputs(data, submission, archive, pack, Plain(data, looped), ByteMoving(data.grid))
        opened.count(data.tokens[:64], pack.planes_of, 2)  # compiled, and memory allocated, before the timing
        opened.moving(data, data.tokens[:64])
        started_s = time.process_time()
        with open_submission(data.zip_path, data.tokens, data.grid):
            open_s = time.process_time() - started_s
        confusions = take_turns(opened, clocks)
    lengths = [len(rows) for rows in np.array_split(confusions, 5)]
    total = named_ratios(confusions.sum(axis=(0, 1), dtype=np.int64))
    with clocks[INTERVALS].turn(1):
        interval_record(total, spectra_of(confusions, tuple(lengths), METRICS[METRIC_VERSION]), METRICS[METRIC_VERSION])
    return open_s


def peak_bytes(data: Material) -> int:
    """Return the peak memory of a process that only scores."""
    command = [sys.executable, "-m", "benchmarks.score.memory", str(data.zip_path), str(data.pack_path)]
    return int(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def table_of(clocks: dict[str, ScoreTimes]) -> Table:
    table = Table(title="Scoring (processor time, median of turns)")
    for column in ("what", "frames", "ms/frame", "wall ms/frame", "this / ours"):
        table.add_column(column, justify="left" if column == "what" else "right")
    for name, clock in clocks.items():
        ratio = f"{clock.median_ms / clocks[OURS].median_ms:.2f}" if clock.frames > 1 else ""
        wall_ms = 1e3 * clock.wall_s / clock.frames
        table.add_row(name, str(clock.frames), f"{clock.median_ms:.3f}", f"{wall_ms:.3f}", ratio)
    return table


def verdicts(clocks: dict[str, ScoreTimes], peak: int) -> Table:
    table = Table(title="Expected")
    for column in ("what", "expected", "truth in memory", "", "from the pack", ""):
        table.add_column(column)
    for name, bound, limit in EXPECTED:
        row = [name, f"{bound} {limit:g} x"]
        for ours in (OURS, PACKED):
            quick, other = clocks[ours].median_ms, clocks[name].median_ms
            ratio = quick / other if name == LIMIT else other / quick
            is_met = ratio <= limit if name == LIMIT else ratio >= limit
            row += [f"{ratio:.2f} x", "met" if is_met else "NOT met"]
        table.add_row(*row)
    row = ["peak memory", f"at most {MOST_MEMORY_BYTES / 1e6:.0f} MB", "", "", f"{peak / 1e6:.0f} MB"]
    table.add_row(*row, "met" if peak <= MOST_MEMORY_BYTES else "NOT met")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=7000)
    parser.add_argument("--grid", choices=GRIDS, default="paper")
    options = parser.parse_args()
    frame_count = max(options.frames, TURNS * LOOPED)
    clocks = {name: ScoreTimes() for name in NAMES}
    with TemporaryDirectory() as folder:
        data = material(Path(folder), frame_count, GRIDS[options.grid])
        open_s = measure(data, clocks)
        peak = peak_bytes(data)
        sizes = [path.stat().st_size / 1e6 for path in (data.zip_path, data.pack_path)]
    console = Console()
    console.print(table_of(clocks))
    console.print(verdicts(clocks, peak))
    facts = f"{frame_count} frames at {data.grid}, zip of {sizes[0]:.0f} MB, pack of {sizes[1]:.0f} MB"
    console.print(f"{facts}; the zip's directory is checked in {1e3 * open_s:.0f} ms")
    console.print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}: wall times mean little at a load above 1")


if __name__ == "__main__":
    main()
