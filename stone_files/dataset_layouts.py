"""The layouts of published datasets: their labels, tokens and sweeps, with the source of each fact.

**Conventions.** One row per layout. Readers, layout recognition, the label exporter and the test dataset makers use
only this table.

Sources: the paper; the README of the release at revision 4ba5f700, and a third party that read its archive by byte
ranges (arrays, tables and bags); Occ3D (arXiv 2304.14365).
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from stone_base.errors import Refused
from stone_base.label_grid import GRIDS, OCC3D, PAPER, RELEASE, LabelGrid

PLAIN_TOKEN = re.compile(r"[0-9a-f]{32}")
DASHED_TOKEN = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}")


@dataclass(frozen=True)
class DatasetLayout:
    """The file conventions of a layout.

    `label_key` is the array of classes in labels.npz. With `has_masks`, its files have `mask_lidar` and `mask_camera`;
    otherwise voxels of value `grid.unknown` are unobserved. With `has_dashes`, sample tokens are UUIDs. With
    `has_no_returns`, a sweep has a row for every shot, and shots without a return are NaN. `roots` are names of its
    root folder.
    """

    name: str
    grid: LabelGrid
    label_key: str
    has_masks: bool
    has_dashes: bool
    has_no_returns: bool
    tables: str
    roots: tuple[str, ...]
    source: str

    def with_grid(self, grid: LabelGrid) -> "DatasetLayout":
        """Return the layout with another grid."""
        return replace(self, grid=grid)


LAYOUTS: Mapping[str, DatasetLayout] = {
    layout.name: layout
    for layout in (
        DatasetLayout(
            "paper", PAPER, "semantics", True, False, False, "v1.0-trainval", (), "the paper; docs/formats/exports.md"
        ),
        DatasetLayout(
            "release", RELEASE, "label", False, True, True, "v1.0-trainval", ("STONE_nus_dataset",),
            "README 4ba5f700; arrays checked against LiDAR by a third party",
        ),
        DatasetLayout(
            "occ3d", OCC3D, "semantics", True, False, False, "v1.0-trainval", ("Occ3D-nuScenes",), "arXiv 2304.14365"
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class ReleaseFacts:
    """Sizes of the released dataset, from its README and from a third party that read its archive."""

    zip_bytes: int = 346_343_831_255
    zip_entries: int = 458_212
    scenes: int = 279
    frames_a_scene: int = 200
    shots_a_sweep: int = 230_400
    least_returns: int = 101_407
    most_returns: int = 206_072
    least_occupied: int = 1_405
    most_occupied: int = 10_691
    frames_of_longest_bag: int = 1_781
    cameras: int = 6
    logs: tuple[str, ...] = ("siheung_lake", "siheung_farmland", "siheung_land", "kwangmyeong_land")
    vehicles: tuple[str, ...] = ("n001", "n002", "n003", "n004")


RELEASE_FACTS = ReleaseFacts()


def named_layout(name: str) -> DatasetLayout:
    """Return the layout of this name. Raises `bad_layout`."""
    if name not in LAYOUTS:
        raise Refused("bad_layout", f"unknown layout {name[:80]!r}; choose one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]


def recognised_layout(keys: Collection[str], shape: tuple[int, ...] | None, *, has_dashes: bool) -> DatasetLayout:
    """Return the layout of a label file with these keys and this shape of its classes, and of tokens with or without
    dashes.

    Without labels (no keys, no shape), only the tokens decide. If no known grid has the shape, the layout keeps its own
    grid.
    """
    of_key = [layout for layout in LAYOUTS.values() if layout.label_key in keys] or [
        layout for layout in LAYOUTS.values() if layout.has_dashes == has_dashes
    ]
    layout = next((layout for layout in of_key if layout.grid.shape == shape), of_key[0])
    grid = next((grid for grid in (layout.grid, *GRIDS.values()) if grid.shape == shape), layout.grid)
    return layout.with_grid(grid)


def plain_token(written: str) -> str | None:
    """Return the frame token (32 hex digits) of a token in a dataset: 32 hex digits or a UUID; None for other text."""
    if PLAIN_TOKEN.fullmatch(written):
        return written
    return written.replace("-", "") if DASHED_TOKEN.fullmatch(written) else None


def dashed_token(token: str) -> str:
    """Return 32 hex digits in UUID form."""
    return "-".join((token[:8], token[8:12], token[12:16], token[16:20], token[20:]))
