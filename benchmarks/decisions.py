"""The effect of each choice that the paper leaves open: `python -m benchmarks.decisions [--seeds 1 2]`.

A simulated world of 64 × 900 rays is labelled repeatedly, each time with one decision changed. Every label set is
compared with the exact truth, as in `benchmarks.truth`. The figures are T ∪ P against drivable ground in every fifth
frame, remains of a walker, and unmeasured labelled voxels. `--short` labels drives of these lengths, for which the
meaning of elevation and the floor of the reference matter. Worlds and figures are stored in `--folder`; `--table`
prints the stored figures again. Differences below a hundredth are those of the world, not of the decision: compare
several seeds.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.truth.__main__ import simulated
from benchmarks.truth.checks import Drive, evidence_counts, judged, walker_counts
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters, parameters_for
from simulator.options import SimulateOptions

WORKERS = 2
OUT_OF_REACH_M = 1.0  # no point qualifies for the vote, so nothing is voted out
PAPER, LOCAL = parameters_for("paper"), parameters_for("local")
UNFLOORED = replace(LOCAL, reference=replace(LOCAL.reference, floor_voxels=0))
DECISIONS: Mapping[str, LabelParameters] = {
    "default (paper)": PAPER,
    "h above local ground (local)": LOCAL,
    "local, no floor": UNFLOORED,
    "footprint band ± 0.10 m": replace(PAPER, footprint_band_m=0.10),
    "footprint band ± 0.25 m": replace(PAPER, footprint_band_m=0.25),
    "footprint band ± 0.50 m": replace(PAPER, footprint_band_m=0.50),
    "α = 0.01": replace(PAPER, reference=replace(PAPER.reference, alpha=0.01)),
    "α = 0.10": replace(PAPER, reference=replace(PAPER.reference, alpha=0.10)),
    "k = 10": replace(PAPER, terrain=replace(PAPER.terrain, neighbours=10)),
    "k = 40": replace(PAPER, terrain=replace(PAPER.terrain, neighbours=40)),
    "no vote on what moved": replace(PAPER, dynamic=replace(PAPER.dynamic, max_range_m=OUT_OF_REACH_M)),
    "seen in 3 frames, no vote": replace(
        PAPER,
        dynamic=replace(PAPER.dynamic, max_range_m=OUT_OF_REACH_M),
        surface=replace(PAPER.surface, min_frames=3),
    ),
    "trim 0.4 m": replace(PAPER, surface=replace(PAPER.surface, trim_m=0.4)),
    "Open3D's octree": replace(PAPER, surface=replace(PAPER.surface, solver="octree")),
    "Open3D's octree, trim 1 m": replace(PAPER, surface=replace(PAPER.surface, solver="octree", trim_m=1.0)),
}
SHORT: Mapping[str, LabelParameters] = {"paper": PAPER, "local": LOCAL, "local, no floor": UNFLOORED}
Figures = dict[str, float]
ROWS = (
    ("iou", "IoU", ".3f"),
    ("precision", "precision", ".3f"),
    ("recall", "recall", ".3f"),
    ("driven", "T voxels", ".0f"),
    ("voxels", "map voxels", ".0f"),
    ("walker", "walker, labelled", ".0f"),
    ("unobserved", "unobserved", ".0f"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--short", type=float, nargs="*", default=[2.0, 5.0, 10.0])
    parser.add_argument("--only", nargs="*", help="only decisions whose names start with these words")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-truth")
    parser.add_argument("--table", action="store_true", help="only print stored figures")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    chosen = {name: decision for name, decision in DECISIONS.items() if name.startswith(tuple(options.only or ("",)))}
    for seed in options.seeds:
        figures = _measured(options, (options.seconds, seed), chosen)
        _show(f"one decision changed, {options.seconds:g} s, seed {seed}", figures)
        for seconds in options.short:
            _show(f"a drive of {seconds:g} s, seed {seed}", _measured(options, (seconds, seed), SHORT))


def _measured(
    options: argparse.Namespace, world: tuple[float, int], variants: Mapping[str, LabelParameters]
) -> dict[str, Figures]:
    """Return the figures of each variant in the world (seconds, seed); figures of an earlier run are reused."""
    seconds, seed = world
    path = options.folder / f"decisions-{seed}-{seconds:g}s.json"
    kept: dict[str, Figures] = json.loads(path.read_text()) if path.exists() else {}
    if options.table:
        return {name: kept[name] for name in variants if name in kept}
    drive = simulated(options.folder / f"world-{seed}-{seconds:g}s.mcap", SimulateOptions(seconds, seed, cameras=False))
    for name, parameters in variants.items():
        kept[name] = _figures(drive, options.folder / f"decision-{seed}-{seconds:g}s", parameters)
        path.write_text(json.dumps(kept, indent=1) + "\n")
    return {name: kept[name] for name in variants}


def _figures(drive: Drive, folder: Path, parameters: LabelParameters) -> Figures:
    """Label into `folder` and compare with the truth; with another surface also count unmeasured voxels."""
    record = label(drive.sequence, drive.sweeps, folder, LabelOptions(parameters, WORKERS)).as_record()
    verdict, walker = judged(drive, folder), walker_counts(drive, folder)
    is_other_surface = replace(parameters.surface, min_frames=1) != PAPER.surface
    unobserved = {"unobserved": evidence_counts(drive, folder).beyond_reach} if is_other_surface else {}
    return {
        **{name: getattr(verdict, name) or 0.0 for name in ("iou", "precision", "recall")},
        "driven": record["reference"]["voxels"],
        "voxels": record["map"]["voxels"],
        "walker": int(sum(walker.labelled)),
        **unobserved,
    }


def _show(title: str, figures: Mapping[str, Figures]) -> None:
    table = Table(title=title)
    table.add_column("decision")
    for _, name, _ in ROWS:
        table.add_column(name, justify="right")
    for decision, of_one in figures.items():
        table.add_row(decision, *(format(of_one[key], form) if key in of_one else "" for key, _, form in ROWS))
    Console(width=max(Console().width, 130)).print(table)


if __name__ == "__main__":
    main()
