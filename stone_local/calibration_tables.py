"""A calibration as tables for people: sensors, lenses, the recording's channels, and the content of each partial file.

**Conventions.** As in `stone_client.tables`, every value comes from the record that `--json` prints.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

from stone_client.tables import DASH, plain_table, safe_text


def sensor_table(record: Mapping[str, Any], file: str) -> Table:
    """Return the pose of each sensor on the robot."""
    title = (
        f"{safe_text(file)}, read as {record['format']}: {safe_text(record['name'])}; in the ego frame, m and degrees"
    )
    table = plain_table(title, "sensor", "kind", "x", "y", "z", "roll", "pitch", "yaw")
    table.add_column("frame", overflow="fold")
    for sensor in record["sensors"]:
        places = (f"{sensor[key]:.3f}" for key in ("x_m", "y_m", "z_m"))
        turns = (f"{sensor[key]:.2f}" for key in ("roll_deg", "pitch_deg", "yaw_deg"))
        frame = safe_text(sensor["frame_id"]) or DASH
        table.add_row(safe_text(sensor["name"]), sensor["kind"], *places, *turns, frame)
    return table


def lens_table(record: Mapping[str, Any]) -> Table | None:
    """Return the lens of each camera; None without cameras."""
    cameras = [sensor for sensor in record["sensors"] if sensor["kind"] == "camera"]
    table = plain_table("intrinsics, pixels", "camera", "model", "size", "fx", "fy", "cx", "cy", "sees")
    table.add_column("distortion", overflow="fold")
    for camera in cameras:
        table.add_row(safe_text(camera["name"]), *_lens(camera["intrinsics"]))
    return table if cameras else None


def channel_table(channels: Sequence[Mapping[str, Any]]) -> Table:
    """Return the sensor of each topic of the recording."""
    table = Table(box=plain_table("").box, title="topics of the recording", title_justify="left")
    for column in ("topic", "role", "frame", "sensor"):
        table.add_column(column, overflow="fold")
    for match in channels:
        names = (match["topic"], match["role"], match["frame_id"] or DASH, match["sensor"] or DASH)
        table.add_row(*map(safe_text, names))
    return table


def file_table(files: Sequence[Mapping[str, Any]]) -> Table:
    """Return the content of each file."""
    table = Table(box=plain_table("").box, title="findings", title_justify="left")
    for column in ("file", "read as", "transforms", "lenses"):
        table.add_column(column, overflow="fold")
    for item in files:
        pairs = ", ".join(f"{parent} <- {child}" for parent, child in item["transforms"][:12])
        names = (item["file"], item["format"], pairs or DASH, ", ".join(item["lenses"][:12]) or DASH)
        table.add_row(*map(safe_text, names))
    return table


def notes(record: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines on the footprint, the vehicle's limits, the boxes, missing parts and the ground."""
    footprint = record["footprint"]
    origin = "default" if footprint["is_default"] else "given"
    yield f"footprint: {footprint['length_m']:g} x {footprint['width_m']:g} m ({origin})"
    vehicle = record["vehicle"]
    limits = f"slope {vehicle['max_slope_deg']:g}°, step {vehicle['max_step_m']:g} m, height {vehicle['height_m']:g} m"
    yield f"vehicle: {limits} ({'default' if vehicle['is_default'] else 'given'})"
    yield f"self boxes: {len(record['self_boxes_ego'])}"
    yield from (f"missing: {part}" for part in record["missing"])
    ground = record.get("ground")
    if ground is not None:
        yield (
            f"ground: {ground['height_m']:+.2f} m from the ego origin, tilted by {ground['tilt_deg']:.1f}° "
            f"({ground['sweeps']} sweeps, 5 to 95 %: {ground['low_m']:+.2f} to {ground['high_m']:+.2f} m)"
        )


def _lens(lens: Mapping[str, Any] | None) -> tuple[str, ...]:
    if lens is None:
        return (DASH,) * 8
    across, down = lens["field_of_view_deg"]
    numbers = (f"{lens[key]:.1f}" for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
    distortion = " ".join(f"{value:g}" for value in lens["distortion"]) or "none"
    size = f"{lens['width_px']} x {lens['height_px']}"
    return (lens["model"], size, *numbers, f"{across:.0f} x {down:.0f}°", distortion)
