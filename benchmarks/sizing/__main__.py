"""Seconds, memory, disk and rows of a recording and of a submission: `python -m benchmarks.sizing [--frames 300 900]`.

Each is measured at two sizes on fresh platforms with PostgreSQL, which gives the fixed cost and the cost per frame. The
program prints the costs of an hour of recording in drives of ten minutes, of 50,000 frames, and of a season. A season
has 600 submissions to a phase of 5,000 frames. It takes several minutes and 8 GB of disk.
"""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.sizing.costs import CostLine, line_through
from benchmarks.sizing.recordings import SWEEPS_HZ, RecordingCosts, recording_costs, simulated_rig
from benchmarks.sizing.submissions import SEQUENCES, submission_costs

HOUR_FRAMES, DRIVE_FRAMES = round(3600 * SWEEPS_HZ), round(600 * SWEEPS_HZ)
MANY_FRAMES = 50_000
SEASON_SUBMISSIONS, PHASE_FRAMES = 600, 5_000
CONSOLE = Console(width=110, highlight=False)


def main() -> None:
    options = _options()
    small, large = (
        recording_costs(simulated_rig(options.folder, frames), frames, options.workers) for frames in options.frames
    )
    recordings = line_through(small.measured, large.measured)
    _show_recordings(recordings, small.measured.costs)
    _show_most(large)
    submissions = line_through(
        *(submission_costs(frames, options.submissions, options.workers) for frames in options.phase_frames)
    )
    _show_submissions(submissions)


def _show_recordings(line: CostLine, counted: Mapping[str, float]) -> None:
    hour = line.of(HOUR_FRAMES, HOUR_FRAMES / DRIVE_FRAMES)
    many = line.of(MANY_FRAMES, MANY_FRAMES / DRIVE_FRAMES)
    table = Table("of a recording", "once", "1,000 frames", "an hour", f"{MANY_FRAMES:,} frames", title="recordings")
    for what in (name for name in counted if line.once[name] or line.each_frame[name]):
        figures = (line.once[what], 1000 * line.each_frame[what], hour[what], many[what])
        table.add_row(what, *(f"{figure:,.1f}" for figure in figures))
    CONSOLE.print(table)


def _show_submissions(line: CostLine) -> None:
    costs = line.of(PHASE_FRAMES)
    season = line.of(SEASON_SUBMISSIONS * PHASE_FRAMES, SEASON_SUBMISSIONS)
    table = Table(
        "of a submission", "once", "1,000 frames", f"{PHASE_FRAMES:,} frames", "a season", title="submissions"
    )
    for what in (name for name in line.once if line.once[name] or line.each_frame[name]):
        figures = (line.once[what], 1000 * line.each_frame[what], costs[what], season[what])
        table.add_row(what, *(f"{figure:,.2f}" for figure in figures))
    CONSOLE.print(table)


def _show_most(costs: RecordingCosts) -> None:
    table = Table("program", "most MB", title=f"held at once, of {costs.measured.frames} frames")
    for name, most in costs.most_bytes.items():
        table.add_row(name, f"{most / 1e6:,.0f}")
    CONSOLE.print(table)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sizing", description=__doc__)
    parser.add_argument("--frames", type=int, nargs=2, default=[300, 900])
    parser.add_argument("--phase-frames", type=int, nargs=2, default=[60, 240], help=f"multiples of {SEQUENCES}")
    parser.add_argument("--submissions", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    return parser.parse_args()


if __name__ == "__main__":
    main()
