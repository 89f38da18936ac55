"""Tables for a scene of Occ3D's layout, which has none: what annotations.json says of it, as the schema's rows.

**Conventions.** Tokens are the first 32 hex digits of a sha256 over what a row is about; a frame's is its own. Pictures
are named `samples/<CHANNEL>/<scene>__<CHANNEL>__<µs>.<ending>`, since names of the layout may say nothing. There is no
LiDAR, so no row of one.
"""

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from stone.geometry.se3 import SE3
from stone_datasets.build import NS_PER_US
from stone_datasets.faults import DatasetPlace
from stone_datasets.index import DatasetChannel, DatasetSequence
from stone_datasets.scene_tables import TABLES, SceneTableFiles, encoded
from stone_datasets.table_faults import StampOrderError
from stone_files.dataset_layout import ANNOTATIONS

CLASSES = ("free", "traversable", "potentially_traversable", "non_traversable")
MOST_BYTES = 1 << 40  # of one scene: as much as its annotations say, a few times
Row = Mapping[str, Any]


def write_annotated_tables(sequence: DatasetSequence, folder: Path) -> None:
    """The tables of the scene into its folder. Raises `StampOrderError` where a camera's stamps do not rise."""
    out = SceneTableFiles(1, lambda _: folder, MOST_BYTES)
    rows = _rows(sequence)
    for table in TABLES:
        out.write(table, (((0,), encoded(row)) for row in rows.get(table, ())))


def picture_names(sequence: DatasetSequence, channel: DatasetChannel) -> tuple[str, ...]:
    """The names of a channel's files in the release's layout. Raises `StampOrderError`."""
    name, stamps_us = channel.sensor.channel, channel.stamps_ns // NS_PER_US
    if (np.diff(stamps_us) <= 0).any():
        place = DatasetPlace(f"{ANNOTATIONS} scene {sequence.name}")
        raise StampOrderError(place, f"the stamps of {name} do not increase from frame to frame")
    endings = ("png" if channel.filename(at).endswith(".png") else "jpg" for at in range(len(stamps_us)))
    return tuple(
        f"samples/{name}/{sequence.name}__{name}__{stamp_us}.{ending}"
        for stamp_us, ending in zip(stamps_us.tolist(), endings, strict=True)
    )


def _token(kind: str, *facts: object) -> str:
    return sha256(repr((kind, *facts)).encode()).hexdigest()[:32]


def _rows(sequence: DatasetSequence) -> Mapping[str, Iterable[Row]]:
    name, channels = sequence.name, sequence.channels
    begun = datetime.fromtimestamp(int(sequence.stamps_ns[0]) // 10**9, UTC)
    return {
        "category": [
            {"token": _token("category", one), "name": one, "description": "", "index": index}
            for index, one in enumerate(CLASSES)
        ],
        "sensor": [{"token": _token("sensor", one), "channel": one, "modality": "camera"} for one in channels],
        "calibrated_sensor": [_mounted(sequence, channel) for channel in channels.values()],
        "log": [
            {"token": _token("log", name), "logfile": "", "vehicle": "", "date_captured": f"{begun:%Y-%m-%d}",
             "location": ""}
        ],
        "scene": [
            {"token": _token("scene", name), "log_token": _token("log", name), "nbr_samples": len(sequence),
             "first_sample_token": sequence.tokens[0], "last_sample_token": sequence.tokens[-1], "name": name,
             "description": ""}
        ],
        "sample": _samples(sequence),
        "ego_pose": (row for channel in channels.values() for row in _poses(sequence, channel)),
        "sample_data": (row for channel in channels.values() for row in _data(sequence, channel)),
    }  # fmt: skip


def _mounted(sequence: DatasetSequence, channel: DatasetChannel) -> Row:
    sensor, lens = channel.sensor, channel.sensor.intrinsics
    row: dict[str, Any] = {
        "token": _token("calibrated_sensor", sequence.name, sensor.channel),
        "sensor_token": _token("sensor", sensor.channel),
        **_posed(sensor.ego_from_sensor),
        "camera_intrinsic": [],
    }
    if lens is None:
        return row
    matrix = [[lens.fx_px, 0.0, lens.cx_px], [0.0, lens.fy_px, lens.cy_px], [0.0, 0.0, 1.0]]
    said = {"camera_model": lens.model, "camera_distortion": list(lens.distortion)}
    return row | {"camera_intrinsic": matrix} | said


def _posed(pose: SE3) -> Row:
    return {"rotation": pose.wxyz.tolist(), "translation": pose.translation_m.tolist()}


def _samples(sequence: DatasetSequence) -> Iterator[Row]:
    chain = ("", *sequence.tokens, "")
    for index, stamp_ns in enumerate(sequence.stamps_ns.tolist()):
        yield {
            "token": chain[index + 1],
            "timestamp": stamp_ns // NS_PER_US,
            "prev": chain[index],
            "next": chain[index + 2],
            "scene_token": _token("scene", sequence.name),
        }


def _datum_token(sequence: DatasetSequence, channel: DatasetChannel, place: int) -> str:
    """ "" outside of them, as the schema ends its chains."""
    if not 0 <= place < len(channel.frames):
        return ""
    return _token("sample_data", sequence.tokens[int(channel.frames[place])], channel.sensor.channel)


def _poses(sequence: DatasetSequence, channel: DatasetChannel) -> Iterator[Row]:
    for place, stamp_ns in enumerate(channel.stamps_ns.tolist()):
        token = _datum_token(sequence, channel, place)
        yield {"token": token, "timestamp": stamp_ns // NS_PER_US, **_posed(channel.map_from_ego[place])}


def _data(sequence: DatasetSequence, channel: DatasetChannel) -> Iterator[Row]:
    lens = channel.sensor.intrinsics
    size = (0, 0) if lens is None else (lens.height_px, lens.width_px)
    for place, name in enumerate(picture_names(sequence, channel)):
        token = _datum_token(sequence, channel, place)
        yield {
            "token": token,
            "sample_token": sequence.tokens[int(channel.frames[place])],
            "ego_pose_token": token,
            "calibrated_sensor_token": _token("calibrated_sensor", sequence.name, channel.sensor.channel),
            "timestamp": int(channel.stamps_ns[place]) // NS_PER_US,
            "fileformat": name.rpartition(".")[2],
            "is_key_frame": True,
            "height": size[0],
            "width": size[1],
            "filename": name,
            "prev": _datum_token(sequence, channel, place - 1),
            "next": _datum_token(sequence, channel, place + 1),
        }
