"""The contents of a published dataset as tables: the record of `stone check --json`."""

from collections.abc import Mapping
from typing import Any

from stone_base.counts import counted
from stone_base.label_grid import grid_of
from stone_client.streams import echo_notice
from stone_client.tables import DASH, plain_table, safe_text, show

MOST_SEQUENCES = 60


def show_contents(record: Mapping[str, Any]) -> None:
    """Print its sequences, its sensors and its classes."""
    sequences = record["sequences"]
    title = f"{record['layout']} layout, {counted(len(sequences), 'sequence')}, {counted(record['frames'], 'frame')}, "
    table = plain_table(title + _size(record["size_bytes"]), "sequence", "frames", "seconds", "labels", "split")
    for sequence in sequences[:MOST_SEQUENCES]:
        splits = ", ".join(sequence["splits"]) or DASH
        labels = "yes" if sequence["is_labelled"] else DASH
        table.add_row(
            safe_text(sequence["name"]),
            str(sequence["frames"]),
            f"{sequence['seconds']:.1f}",
            labels,
            safe_text(splits),
        )
    if len(sequences) > MOST_SEQUENCES:
        table.add_row(f"… {len(sequences) - MOST_SEQUENCES} more")
    show(table)
    undated = [sequence["name"] for sequence in sequences if not sequence["is_dated"]]
    if undated:
        echo_notice(f"undated: the stamps of {safe_text(_named(undated))} are of simulated time, or of a clock not set")
    sensors = plain_table("Sensors", "channel", "files")
    for name, count in record["sensors"].items():
        sensors.add_row(safe_text(name), str(count))
    show(sensors)
    show(_classes(record))


def _classes(record: Mapping[str, Any]) -> Any:
    """Return the shares of the occupied voxels, and the number of frames with each mask."""
    title = f"Labels of {counted(record['labelled_frames'], 'frame')}, by the classes of {safe_text(record['classes'])}"
    table = plain_table(title, "", "")
    table.add_row("grid", safe_text(str(grid_of(record["grid"]))))
    for name, share in record["class_share_of_occupied"].items():
        table.add_row(f"{name} of the occupied voxels", DASH if share is None else f"{share:.1%}")
    if record["returns_in_occupied"] is not None:
        shares = record["returns_in_occupied"]
        for name, key in (("their own labels", "own_frame"), ("labels of a frame near by", "frame_near_by")):
            if "as stated" in shares[key]:
                table.add_row(f"LiDAR returns in occupied voxels of {name}", f"{shares[key]['as stated']:.1%}")
    for name, count in record["masks"].items():
        table.add_row(f"frames with {name}", str(count))
    return table


def _named(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:.2f} GB" if size_bytes >= 1e8 else f"{size_bytes / 1e6:.1f} MB"
