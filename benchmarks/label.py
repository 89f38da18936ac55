"""Labelling simulated full-rig runs of three lengths: `python -m benchmarks.label [--frames 300 1200 5000]`.

Each run is a bag of 128 × 1800 rays and six cameras at 10 Hz, simulated once and stored in `--folder` (5,000 frames
take 19 GB). A child process per length synchronises and labels it, including masks and removal of movers; only this
process is timed. It prints recorded seconds per CPU second (all processes), wall seconds, and peak resident memory (all
processes, including the solver's children). Then `--peer-frames` of the shortest run are reconstructed one by one by
`benchmarks/per_frame_poisson.py`.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.per_frame_poisson import per_frame_poisson
from benchmarks.processes import adopt_orphans, reap_orphans

SWEEPS_HZ = 10.0
COLUMNS = ("frames", "recorded s", "wall s", "× real time", "CPU s", "recorded s / CPU s", "largest MB", "all MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[300, 1200, 5000])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--peer-frames", type=int, default=10)
    parser.add_argument("--channels", type=int, default=128)
    parser.add_argument("--columns", type=int, default=1800)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    options = parser.parse_args()
    adopt_orphans()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows = [_measured(_simulated(frames, options), frames, options) for frames in options.frames]
    _show(rows, options.workers)
    if options.peer_frames:
        _show_peer(_simulated(options.frames[0], options), rows[0], options)


def _simulated(frames: int, options: argparse.Namespace) -> Path:
    """Return the bag of this length, from an earlier run if it exists."""
    bag: Path = options.folder / f"rig-{options.channels}x{options.columns}-{frames}.mcap"
    if not bag.exists():
        command = [_stone(), "simulate", str(bag), "--seconds", str(frames / SWEEPS_HZ)]
        command += ["--channels", str(options.channels), "--columns", str(options.columns)]
        subprocess.run(command, check=True)
    return bag


def _measured(bag: Path, frames: int, options: argparse.Namespace) -> dict[str, float]:
    """Label once in a process of its own; CPU is the operating system's account of it and all its descendants."""
    out = options.folder / f"labels-{frames}"
    calibration = bag.with_suffix(".calibration.yaml")
    command = [_stone(), "label", str(bag), "--calibration", str(calibration), "-o", str(out)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    subprocess.run([*command, "--workers", str(options.workers)], check=True)
    wall_s = time.perf_counter() - begin
    reap_orphans()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads((out / "report.json").read_text())
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    recorded_s = report["frames"] / SWEEPS_HZ
    return {
        "frames": report["frames"],
        "recorded s": recorded_s,
        "wall s": wall_s,
        "× real time": recorded_s / wall_s,
        "CPU s": cpu_s,
        "recorded s / CPU s": recorded_s / cpu_s,
        "largest MB": report["peak_bytes"]["largest_process"] / 1e6,
        "all MB": report["peak_bytes"]["all_processes"] / 1e6,
    }


def _show(rows: list[dict[str, float]], workers: int) -> None:
    table = Table(title=f"labelling with {workers} workers")
    for column in COLUMNS:
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(f"{row[column]:.2f}" if column != "frames" else f"{row[column]:.0f}" for column in COLUMNS))
    console = Console()
    console.print(table)
    if len(rows) > 1:
        growth = rows[-1]["all MB"] / rows[0]["all MB"]
        console.print(f"memory growth {rows[0]['frames']:.0f} → {rows[-1]['frames']:.0f} frames: {growth:.2f}×")


def _show_peer(bag: Path, row: dict[str, float], options: argparse.Namespace) -> None:
    with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
        calibration = bag.with_suffix(".calibration.yaml")
        peer = per_frame_poisson(bag, calibration, options.peer_frames, Path(scratch))
    theirs, ours = float(np.median(peer.cpu_s)), row["CPU s"] / row["frames"]
    Console().print(
        f"Poisson frame by frame, {len(peer.cpu_s)} of the {row['frames']:.0f} frames: {theirs:.2f} CPU s a frame "
        f"(median; {min(peer.cpu_s):.2f} to {max(peer.cpu_s):.2f}, {int(np.median(peer.voxels))} voxels); "
        f"ours {ours:.4f}, reading and masks included: {theirs / ours:.0f}×"
    )


def _stone() -> str:
    return str(Path(sys.executable).with_name("stone"))


if __name__ == "__main__":
    main()
