"""Tables that compare two label sets (the record of `stone label-set compare --json`)."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from stone_client.tables import DASH, plain_table

RATIOS = {"iou_occ": "occupied", "iou_t": "T", "iou_p": "P", "iou_n": "N", "miou": "mean T P N"}


def agreement_table(record: Mapping[str, Any]) -> Table:
    """Return the agreement over all voxels, and over the voxels that both label sets observed."""
    blocks = (record["all_voxels"], record["seen_in_both"])
    apart = ", ".join(f"{record[key]:,} in {name} only" for key, name in (("only_in_a", "A"), ("only_in_b", "B")))
    table = plain_table(f"{record['frames']:,} frames in both, {apart}", "", "all voxels", "observed in both")
    table.add_row("same class, of occupied in either", *(_of(block, "agreement_ratio") for block in blocks))
    for key, name in RATIOS.items():
        table.add_row(f"IoU {name}", *(_percent(block["ratios"][key]) if block else DASH for block in blocks))
    return table


def ring_table(rings: Sequence[Mapping[str, Any]]) -> Table:
    """Return the agreement by horizontal distance from the robot."""
    table = plain_table("all voxels, by distance from the robot", "m", "same class", *RATIOS.values())
    for ring in rings:
        span = f"{ring['from_m']:g}–{ring['to_m']:g}" if ring["to_m"] is not None else f"{ring['from_m']:g} and more"
        table.add_row(span, _of(ring, "agreement_ratio"), *(_percent(ring["ratios"][key]) for key in RATIOS))
    return table


def least_alike_table(frames: Sequence[Mapping[str, Any]]) -> Table:
    """Return the frames with the least agreement, the least first."""
    table = plain_table("least similar frames", "frame", "same class")
    for frame in frames:
        table.add_row(frame["token"], _percent(frame["agreement_ratio"]))
    return table


def _of(block: Mapping[str, Any] | None, key: str) -> str:
    return DASH if block is None else _percent(block[key])


def _percent(ratio: float | None) -> str:
    return DASH if ratio is None else f"{100 * ratio:.2f} %"
