"""Labels against worlds whose truth is known: `python -m benchmarks.truth [--seconds 30] [--seeds 1 2] [--folder DIR]`.

Per seed a world of 64 × 900 rays is simulated (kept in `--folder`) and labelled three times with profile `paper`: as
`stone label` does; in other parts on one worker; and as one cube, without a seam. The labels do not see the truth.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.truth_checks import (
    EVIDENCE_EVERY,
    EVIDENCE_M,
    SEAM_EVERY,
    Drive,
    SeamCounts,
    evidence_counts,
    footprint_counts,
    seam_counts,
    slope_errors_deg,
)
from services.ingest.opening import open_sequence
from services.labeler.parameters import TilingParameters, parameters_for
from services.labeler.pipeline import LabelOptions, label
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from simulator.truth import read_truth
from simulator.verdict import Verdict, judge_labels
from stone.se3 import SE3

WORKERS = 2
OTHER_PARTS = TilingParameters(frames_per_part=25)
UNTILED = TilingParameters(cube_cells=1024)  # 204.8 m, of which 201.6 m core: one holds a run of a minute
COARSEST_LATTICE_M = 0.8  # a brick of observed voxels; a shift by multiples keeps every lattice of the map


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-truth")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    figures = {seed: _figures(options.folder, seed, options.seconds) for seed in options.seeds}
    _show(figures, options.seconds)


def _figures(folder: Path, seed: int, seconds: float) -> dict[str, str]:
    """Every figure of one world, in the order of the table."""
    drive = _simulated(folder / f"world-{seed}-{seconds:g}s.mcap", SimulateOptions(seconds, seed, cameras=False))
    default, cubes = _labelled(drive, folder / f"labels-{seed}", TilingParameters(), WORKERS)
    parts, _ = _labelled(drive, folder / f"labels-{seed}-parts", OTHER_PARTS, 1)
    untiled, untiled_cubes = _labelled(_amid_cube(drive), folder / f"labels-{seed}-untiled", UNTILED, WORKERS)
    return {
        "frames": str(len(drive.sequence.frames)),
        **_verdict_figures(judge_labels(default / "gts", drive.truth)),
        **_check_figures(drive, default),
        **_seam_figures(f"{OTHER_PARTS.frames_per_part} frames a part, 1 worker", seam_counts(drive, default, parts)),
        "cubes: default, untiled": f"{cubes}, {untiled_cubes}",
        **_seam_figures("untiled", seam_counts(drive, default, untiled)),
    }


def _simulated(bag: Path, options: SimulateOptions) -> Drive:
    """The drive of these options, from an earlier run where there is one."""
    truth_dir = bag.with_suffix(".truth")
    if not (bag.exists() and truth_dir.exists()):
        simulate(bag, options, truth_dir)
    sequence, sweeps = open_sequence(bag, calibration_path(bag), bag.stem)
    return Drive(sequence, sweeps, read_truth(truth_dir))


def _amid_cube(drive: Drive) -> Drive:
    """The same run moved to the middle of an untiled cube: the map begins where four of them meet."""
    frames = drive.sequence.frames
    track = frames.map_from_ego.translation_m[:, :2]
    core_m = replace(parameters_for("paper"), tiling=UNTILED).core_m
    shift_m = core_m / 2 - (track.min(axis=0) + track.max(axis=0)) / 2
    moved = frames.map_from_ego.wxyz_xyz.copy()
    moved[:, 4:6] += np.round(shift_m / COARSEST_LATTICE_M) * COARSEST_LATTICE_M
    return replace(drive, sequence=replace(drive.sequence, frames=replace(frames, map_from_ego=SE3(moved))))


def _labelled(drive: Drive, folder: Path, tiling: TilingParameters, workers: int) -> tuple[Path, int]:
    """The label set, and how many cubes it took."""
    parameters = replace(parameters_for("paper"), tiling=tiling)
    report = label(drive.sequence, drive.sweeps, folder, LabelOptions(parameters, workers))
    return folder, len(report.tiles)


def _verdict_figures(verdict: Verdict) -> dict[str, str]:
    ratios = {
        "IoU of T ∪ P with drivable ground": verdict.iou,
        "precision": verdict.precision,
        "recall": verdict.recall,
        "IoU of calling everything traversable": verdict.everything_iou,
    }
    return {name: "no support" if ratio is None else f"{ratio:.3f}" for name, ratio in ratios.items()}


def _check_figures(drive: Drive, labels: Path) -> dict[str, str]:
    errors_deg, smoothed_deg = slope_errors_deg(drive, labels / "mesh.ply")
    footprint, evidence = footprint_counts(drive, labels), evidence_counts(drive, labels)
    return {
        "slope: median absolute error, degrees": f"{np.median(errors_deg):.2f}",
        "… against the ground smoothed over 0.4 m": f"{np.median(smoothed_deg):.2f}",
        "slope: ground vertices": f"{len(errors_deg)}",
        "T under the footprint, centre of the grid's voxel": _share(footprint.in_grid_t, footprint.in_grid),
        "T under the footprint, and the map's, with surface": _share(footprint.in_map_t, footprint.in_map),
        f"labelled voxels of every {EVIDENCE_EVERY}th frame": f"{evidence.labelled}",
        f"… with no point within {EVIDENCE_M} m": _share(evidence.without_point, evidence.labelled),
        f"… with no ray within {EVIDENCE_M} m": _share(evidence.without_ray, evidence.labelled),
    }


def _seam_figures(name: str, seam: SeamCounts) -> dict[str, str]:
    """Shares of the voxels occupied in either label set, over every `SEAM_EVERY`-th frame."""
    return {
        f"{name}: class differs": _share(seam.class_differs, seam.occupied),
        f"{name}: occupied in one only": _share(seam.in_one_only, seam.occupied),
    }


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.3f} % ({part} of {whole})" if whole else "no support"


def _show(figures: dict[int, dict[str, str]], seconds: float) -> None:
    table = Table(title=f"labels of {seconds:g} s worlds against their truth (seams: every {SEAM_EVERY}th frame)")
    table.add_column("figure")
    for seed in figures:
        table.add_column(f"seed {seed}", justify="right")
    for name in next(iter(figures.values())):
        table.add_row(name, *(world[name] for world in figures.values()))
    Console(width=max(Console().width, 120)).print(table)


if __name__ == "__main__":
    main()
