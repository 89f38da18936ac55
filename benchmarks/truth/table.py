"""The figures of `benchmarks.truth` as a table: a row per figure, a column per world, profiles side by side."""

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from benchmarks.truth.checks import EVIDENCE_EVERY, EVIDENCE_M, JUDGED_EVERY, REACH_M, SEAM_EVERY, WALKER_EVERY

Figures = dict[str, float]

# key, meaning, format, and the expectations of `paper`, `local` and `field`
ROWS = (
    ("frames", "frames", ".0f", ""),
    ("iou", f"IoU of T ∪ P with drivable ground, every {JUDGED_EVERY}th frame", ".3f", "≥ 0.80 | ≥ 0.84 | ≥ 0.93"),
    ("danger", "danger: T ∪ P on what is not drivable", ".3f", "… | … | ≤ 0.02"),
    ("recall", "recall", ".3f", ""),
    ("everything_iou", "IoU of calling everything traversable", ".3f", ""),
    ("profiles_differ", "map voxels the other profile calls otherwise", ".1%", ""),
    ("slope_median_deg", "slope: median absolute error, degrees", ".2f", ""),
    ("slope_p95_deg", "slope: 95 % are below, degrees", ".2f", ""),
    ("roughness_median_log_m2", "roughness: median absolute error of r, log m²", ".2f", ""),
    ("ground_vertices", "ground vertices", ".0f", ""),
    ("upside_down", "… that face down", ".3%", "≤ 0.3 %"),
    ("footprint_t", "T under the footprint, centre of the grid's voxel", ".3%", ""),
    ("footprint_map_t", "T under the footprint, and the map's, with surface", ".3%", "100 %"),
    ("labelled", f"labelled voxels of every {EVIDENCE_EVERY}th frame", ".0f", ""),
    ("without_point", f"… with no point within {EVIDENCE_M} m", ".3%", ""),
    ("without_ray", f"… with no ray within {EVIDENCE_M} m", ".0f", ""),
    ("unobserved", f"… with no point within {REACH_M} m: unobserved", ".0f", "0"),
    ("invented_tp", "… where a clean LiDAR measured nothing: T or P", ".0f", ""),
    ("invented_n", "… where a clean LiDAR measured nothing: N", ".0f", ""),
    ("walker_voxels", f"voxels the walker went through, every {WALKER_EVERY}th frame", ".0f", ""),
    ("walker_t", "… labelled T", ".0f", "0"),
    ("walker_p", "… labelled P", ".0f", "0"),
    ("walker_n", "… labelled N", ".0f", "0"),
    ("tiles", "tiles", ".0f", ""),
    ("untiled_class_differs", f"untiled: class differs, every {SEAM_EVERY}th frame", ".3%", "< 0.2 %"),
    ("untiled_in_one_only", "untiled: occupied in one only", ".3%", ""),
    ("untiled_iou_differs", "untiled: IoU differs by", ".4f", "< 0.002"),
)


def show(worlds: Mapping[int, Mapping[str, Figures]], title: str) -> None:
    """Print the table of worlds (seed → profile → figure)."""
    table = Table(title=f"{title} (paper | local | field)")
    table.add_column("figure")
    for seed in worlds:
        table.add_column(f"seed {seed}", justify="right")
    table.add_column("expected", justify="right")
    for key, name, form, expected in ROWS:
        table.add_row(name, *(_cell(world, key, form) for world in worlds.values()), expected)
    Console(width=max(Console().width, 180)).print(table)


def _cell(world: Mapping[str, Figures], key: str, form: str) -> str:
    cells = [format(figures[key], form) for figures in world.values() if figures.get(key) is not None]
    return (cells[0] if len(set(cells)) == 1 else " | ".join(cells)) if cells else "no support"
