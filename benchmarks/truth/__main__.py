"""Labels against five worlds with known truth: `python -m benchmarks.truth [--casts 64 16-noisy …]`.

Per seed a world of 64 × 900 rays is simulated and labelled with each profile, like `stone label`, and once more with
profile `paper` in one cube without a seam. Figures that no profile changes (the mesh, the occupied voxels, T) are
measured once. The same worlds are then cast with 32 and 16 channels and the ranges of a real LiDAR (dropouts, mixed
pixels, rain). They are also cast with rocks, bushes and tall grass close to the track, without the labels in one cube.
Labelling does not use the truth. Worlds, labels and figures are stored in `--folder`; `--table` prints the stored
figures again. `--seeds` and `--seconds` select the worlds and their length.
"""

import argparse
import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.truth.checks import (
    Drive,
    evidence_counts,
    footprint_counts,
    invented_counts,
    judged,
    seam_counts,
    walker_counts,
)
from benchmarks.truth.surface import read_mesh, surface_errors
from benchmarks.truth.table import Figures, show
from services.ingest.sequence import open_sequence
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters, TilingParameters, parameters_for
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from simulator.truth import read_truth
from stone.geometry.se3 import SE3
from stone.labels.profiles import Profile

SEEDS = (1, 2, 3, 4, 5)
NOISY, BESIDE = "-noisy", "-beside"
CASTS = ("64", "32-noisy", "16-noisy", "64-beside")
PROFILES: tuple[Profile, ...] = ("paper", "local", "field")
WORKERS = 2
UNTILED = TilingParameters(cube_cells=1024)  # 204.8 m with a core of 201.6 m: one cube contains a run of a minute
COARSEST_LATTICE_M = 0.8  # a brick of observed voxels; a shift by multiples keeps every lattice of the map


@dataclass(frozen=True)
class Cast:
    """The worlds as one LiDAR measures them: `name` is its channels, and whether its ranges are realistic."""

    name: str
    folder: Path
    seconds: float

    @property
    def is_noisy(self) -> bool:
        return self.name.endswith(NOISY)

    @property
    def channels(self) -> int:
        return int(self.name.partition("-")[0])

    @property
    def is_beside(self) -> bool:
        return self.name.endswith(BESIDE)

    @property
    def title(self) -> str:
        noise = ", ranges with dropouts, mixed pixels and rain" if self.is_noisy else ""
        noise += ", rocks, bushes and tall grass beside the track" if self.is_beside else ""
        return f"labels of {self.seconds:g} s worlds against their truth: {self.channels} channels{noise}"

    def named(self, stem: str) -> Path:
        """Return a file or folder of this cast's own; casts of 64 channels without noise have plain names."""
        return self.folder / (stem if self.name == CASTS[0] else f"{self.name}-{stem}")

    def figures_file(self, seed: int) -> Path:
        return self.named(f"figures-{seed}-{self.seconds:g}s.json")

    def drive(self, seed: int) -> Drive:
        """Return the drive of this seed, simulated if it is missing."""
        options = SimulateOptions(self.seconds, seed, self.channels, cameras=False, range_noise=self.is_noisy)
        options = replace(options, beside_track=self.is_beside)
        return simulated(self.named(f"world-{seed}-{self.seconds:g}s.mcap"), options)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument(
        "--casts",
        nargs="+",
        default=CASTS,
        help="channels, with -noisy for a real LiDAR's ranges, -beside for things near",
    )
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-truth")
    parser.add_argument("--table", action="store_true", help="only print stored figures")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for cast in (Cast(name, options.folder, options.seconds) for name in options.casts):
        for seed in () if options.table else options.seeds:
            cast.figures_file(seed).write_text(json.dumps(_figures(cast, seed), indent=1) + "\n")
        show({seed: json.loads(cast.figures_file(seed).read_text()) for seed in options.seeds}, cast.title)


def _figures(cast: Cast, seed: int) -> dict[str, Figures]:
    """Return every figure of one world, by profile."""
    drive = cast.drive(seed)
    figures, folders = dict[str, Figures](), dict[str, Path]()
    for profile in PROFILES:
        folders[profile] = cast.named(f"labels-{seed}-{profile}")
        record = _labelled(drive, folders[profile], parameters_for(profile))
        figures[profile] = record | _labels_measured(drive, folders[profile])
    figures["paper"] |= _map_measured(drive, folders["paper"])
    if cast.is_beside:
        return figures
    if not cast.is_noisy:
        figures["paper"] |= _untiled_measured(drive, folders["paper"], cast.named(f"labels-{seed}-untiled"))
        return figures
    clean = replace(cast, name=CASTS[0]).drive(seed)
    for profile in PROFILES:
        invented = invented_counts(drive, folders[profile], clean)
        figures[profile] |= {"invented_tp": invented[1] + invented[2], "invented_n": invented[3]}
    return figures


def _untiled_measured(drive: Drive, labels: Path, untiled: Path) -> Figures:
    """Return the differences of the labels of profile `paper` from the labels in one cube."""
    record = _labelled(_amid_cube(drive), untiled, replace(parameters_for("paper"), tiling=UNTILED))
    seam = seam_counts(drive, labels, untiled)
    ious = [judged(drive, folder).iou or 0.0 for folder in (labels, untiled)]
    return {
        "untiled_tiles": record["tiles"],
        "untiled_class_differs": seam.class_differs / seam.occupied,
        "untiled_in_one_only": seam.in_one_only / seam.occupied,
        "untiled_iou_differs": abs(ious[1] - ious[0]),
    }


def simulated(bag: Path, options: SimulateOptions) -> Drive:
    """Return the drive of these options, from an earlier run if it exists."""
    truth_dir = bag.with_suffix(".truth")
    if not (bag.exists() and truth_dir.exists()):
        simulate(bag, options, truth_dir)
    sequence, sweeps = open_sequence(bag, calibration_path(bag), bag.stem)
    return Drive(sequence, sweeps, read_truth(truth_dir))


def _amid_cube(drive: Drive) -> Drive:
    """Return the same run moved to the middle of an untiled cube, because the map begins at a corner of four cubes."""
    frames = drive.sequence.frames
    track = frames.map_from_ego.translation_m[:, :2]
    core_m = replace(parameters_for("paper"), tiling=UNTILED).core_m
    shift_m = core_m / 2 - (track.min(axis=0) + track.max(axis=0)) / 2
    moved = frames.map_from_ego.wxyz_xyz.copy()
    moved[:, 4:6] += np.round(shift_m / COARSEST_LATTICE_M) * COARSEST_LATTICE_M
    return replace(drive, sequence=replace(drive.sequence, frames=replace(frames, map_from_ego=SE3(moved))))


def _labelled(drive: Drive, folder: Path, parameters: LabelParameters) -> Figures:
    """Label into `folder`; return the figures of the report."""
    record = label(drive.sequence, drive.sweeps, folder, LabelOptions(parameters, WORKERS)).as_record()
    differing = record["profiles"]["differing_share"]
    return {"frames": record["frames"], "tiles": record["map"]["tiles"], "profiles_differ": differing}


def _labels_measured(drive: Drive, labels: Path) -> Figures:
    """Return the figures that depend on the classes, and so on the profile."""
    verdict, walker = judged(drive, labels), walker_counts(drive, labels)
    return {
        **{name: getattr(verdict, name) for name in ("iou", "danger", "recall", "everything_iou")},
        "walker_voxels": walker.voxels,
        **dict(zip(("walker_t", "walker_p", "walker_n"), walker.labelled, strict=True)),
    }


def _map_measured(drive: Drive, labels: Path) -> Figures:
    """Return the figures that do not: the mesh, the occupied voxels, and T."""
    mesh, poses = read_mesh(labels / "mesh.ply"), (drive.sequence.frames.map_from_ego, drive.world_from_ego())
    errors = surface_errors(mesh, poses, drive.truth)
    footprint, evidence = footprint_counts(drive, labels), evidence_counts(drive, labels)
    return {
        "slope_median_deg": float(np.median(errors.slope_deg)),
        "slope_p95_deg": float(np.percentile(errors.slope_deg, 95)),
        "roughness_median_log_m2": float(np.median(errors.roughness_log_m2)),
        "ground_vertices": len(errors.slope_deg),
        "upside_down": errors.upside_down,
        "footprint_t": footprint.in_grid_t / footprint.in_grid,
        "footprint_map_t": footprint.in_map_t / footprint.in_map,
        "labelled": evidence.labelled,
        "without_point": evidence.without_point / evidence.labelled,
        "without_ray": evidence.without_ray,
        "unobserved": evidence.beyond_reach,
    }


if __name__ == "__main__":
    main()
