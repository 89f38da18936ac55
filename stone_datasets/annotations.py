"""annotations.json of Occ3D: scenes with frames, cameras and splits in one object, read frame by frame.

    {"train_split": [scene, …], "val_split": […], "scene_infos": {scene: {frame token: {"timestamp", "prev", "next",
     "ego_pose", "gt_path", "camera_sensor": {token: {"img_path", "intrinsic", "extrinsic", "ego_pose"}}}}}}

**Conventions.** `extrinsic` is ego_from_camera, in the same form as poses: a quaternion wxyz and metres. A channel is
the folder of `img_path`; the file is searched at that path, below imgs/ and below samples/. Source: README of
CVPR2023-3D-Occupancy-Prediction, "Hierarchy".
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from stone.geometry.se3 import SE3
from stone_base.names import NAME
from stone_base.newer_python import UTC
from stone_datasets.build import NS_PER_US, channel_and_stamp
from stone_datasets.columns import NameColumn
from stone_datasets.faults import DatasetFaultError, DatasetFaults, DatasetPlace, quoted
from stone_datasets.files import DatasetFiles
from stone_datasets.index import DatasetChannel, DatasetIndex, DatasetSequence, label_folder
from stone_datasets.json_stream import JsonStream
from stone_datasets.links import LinkedRows, check_chains
from stone_datasets.rows import FARTHEST_MOUNT_M, FARTHEST_POSE_M, DatasetRow
from stone_datasets.samples import picture_of
from stone_datasets.scene_tables import TABLES, SceneTableFiles, encoded
from stone_datasets.splits import Splits, check_splits, scenes_named, splits_of
from stone_datasets.stamps import clock_faults
from stone_datasets.stated_layout import StatedLayout, form_of_tokens
from stone_exports.frames import ExportedSensor
from stone_files.dataset_layout import ANNOTATIONS, is_inside, path_fault
from stone_files.dataset_layouts import plain_token

SPLIT_KEYS = {"train_split": "train", "val_split": "val", "test_split": "test"}
PICTURE_FOLDERS = ("", "imgs/", "samples/")


@dataclass
class AnnotatedCamera:
    """One camera of a scene, in frame order."""

    first: DatasetRow
    frames: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)


@dataclass
class AnnotatedScene:
    """The state of a scene while its frames are read."""

    name: str
    tokens: list[str] = field(default_factory=list)
    stamps_us: list[int] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)
    links: list[tuple[int, int]] = field(default_factory=list)
    cameras: dict[str, AnnotatedCamera] = field(default_factory=dict)


def read_annotations(files: DatasetFiles, stated: StatedLayout, faults: DatasetFaults) -> DatasetIndex | None:
    """Return the index of a dataset without tables, or None if its faults prevent an index."""
    splits, sequences, names, seen = dict[str, tuple[str, ...]](), list[DatasetSequence](), NameColumn(), set[int]()
    try:
        for scene, rows in _scenes(files, splits):
            sequence = _read_scene(files, (scene, rows, names, seen), faults)
            if sequence is not None:
                sequences.append(sequence)
    except DatasetFaultError as fault:
        faults.add(fault)
        return None
    if len(faults):
        return None
    try:
        form_of_tokens(
            [sequence.label_name(0).split("/")[2] for sequence in sequences if len(sequence)], DatasetPlace(ANNOTATIONS)
        )
    except DatasetFaultError as fault:
        faults.add(fault)
        return None
    check_splits((ANNOTATIONS, splits), [sequence.name for sequence in sequences], faults)
    named = splits_of(splits)
    whole = tuple(replace(sequence, splits=named.get(sequence.name, ())) for sequence in sequences)
    return DatasetIndex(files, stated.of(files, whole), whole, splits)


def compare_annotations(index: DatasetIndex, faults: DatasetFaults) -> Splits:
    """Return the splits in annotations.json, after a check that the file agrees with the tables."""
    splits, known = dict[str, tuple[str, ...]](), {sequence.name: set(sequence.tokens) for sequence in index.sequences}
    try:
        for scene, rows in _scenes(index.files, splits):
            for row in rows:
                token = row.named
                if plain_token(token) not in known.get(scene, ()):
                    faults.add(
                        DatasetFaultError(
                            "DST-030", row.place, f"the tables have no frame of {quoted(scene)} with this token"
                        )
                    )
                elif fault := _fault_of_labels(row, scene):
                    faults.add(fault)
    except DatasetFaultError as fault:
        faults.add(fault)
    return splits


def _scenes(files: DatasetFiles, splits: dict[str, tuple[str, ...]]) -> Iterator[tuple[str, Iterator[DatasetRow]]]:
    """Yield each scene with an iterator of its frames, which must be read before the next scene; fills `splits`."""
    span, names = files.span(ANNOTATIONS), set[str]()
    if span is None:
        raise DatasetFaultError("DST-010", DatasetPlace(ANNOTATIONS), "it is missing")
    stream = JsonStream(span)
    for key in stream.items():
        if key in SPLIT_KEYS:
            splits[SPLIT_KEYS[key]] = scenes_named(ANNOTATIONS, key, stream.value())
        elif key != "scene_infos":
            stream.value()
        else:
            for scene in stream.items():
                if scene in names:
                    raise DatasetFaultError("DST-031", DatasetPlace(ANNOTATIONS), f"{quoted(scene)} is listed twice")
                if NAME.fullmatch(scene) is None:
                    raise DatasetFaultError(
                        "DST-019", DatasetPlace(ANNOTATIONS), f"{quoted(scene)} is not a valid name"
                    )
                names.add(scene)
                yield scene, _frames(stream, scene)
    stream.end()


def _frames(stream: JsonStream, scene: str) -> Iterator[DatasetRow]:
    for number, token in enumerate(stream.items(), 1):
        table = f"{ANNOTATIONS} scene {scene}"
        value = stream.value(number)
        yield DatasetRow(table, number, {token: value}, token).part(token)


Read = tuple[str, Iterator[DatasetRow], NameColumn, set[int]]


def _read_scene(files: DatasetFiles, read: Read, faults: DatasetFaults) -> DatasetSequence | None:
    """Return one scene, or None if its frames cannot be ordered."""
    name, rows, names, seen = read
    scene, before = AnnotatedScene(name), faults.total
    for row in rows:
        try:
            _add_frame(files, scene, (row, names, seen))
        except DatasetFaultError as fault:
            faults.add(fault)
    for at, what, likely in clock_faults(np.array(scene.stamps_us, np.int64)):
        position = DatasetPlace(f"{ANNOTATIONS} scene {name}", at + 1, scene.tokens[at])
        faults.add(DatasetFaultError("DST-028", position, what, likely))
    if faults.total > before:
        return None
    keys, links = [hash(token) for token in scene.tokens], np.array(scene.links, np.int64).reshape(-1, 2)
    columns = (np.array(keys, np.int64), links[:, 0], links[:, 1], np.array(scene.stamps_us, np.int64))
    group = np.zeros(len(keys), np.int64)
    try:
        has_dashes = form_of_tokens(scene.tokens, DatasetPlace(f"{ANNOTATIONS} scene {name}"))
    except DatasetFaultError as fault:
        faults.add(fault)
        return None
    check_chains(LinkedRows(f"{ANNOTATIONS} scene {name}", *columns, group, scene.tokens), faults)
    return replace(_sequence(files, scene, names), has_dashes=has_dashes) if faults.total == before else None


def _add_frame(files: DatasetFiles, scene: AnnotatedScene, what: tuple[DatasetRow, NameColumn, set[int]]) -> None:
    row, names, seen = what
    token = row.named
    if plain_token(token) is None:
        raise row.no_frame_token(token)
    if hash(token) in seen:
        raise DatasetFaultError("DST-018", row.place, "an earlier frame has the same token")
    fault = _fault_of_labels(row, scene.name)
    if fault is not None:
        raise fault
    stamp_us, pose = row.stamp_us(), row.part("ego_pose").pose_numbers(FARTHEST_POSE_M)
    links = (hash(row.link("prev")), hash(row.link("next")))
    cameras = row.part("camera_sensor")
    for camera in cameras.values:
        _add_picture(files, scene, (cameras.part(camera), stamp_us), names)
    seen.add(hash(token))
    scene.tokens.append(token)
    scene.stamps_us.append(stamp_us)
    scene.poses.append(pose)
    scene.links.append(links)


def _fault_of_labels(row: DatasetRow, scene: str) -> DatasetFaultError | None:
    """Return the fault of a frame's label path; test sets have no label paths."""
    wanted = f"{label_folder(scene)}/{row.named}/labels.npz"
    if row.values.get("gt_path", wanted) in (wanted, "", None):
        return None
    return DatasetFaultError("DST-069", row.place, f"gt_path is {quoted(row.values['gt_path'])}; expected {wanted}")


def _add_picture(files: DatasetFiles, scene: AnnotatedScene, what: tuple[DatasetRow, int], names: NameColumn) -> None:
    row, stamp_us = what
    name = row.text("img_path")
    if not is_inside(name):
        raise path_fault("img_path", name, row.place)
    channel = name.rpartition("/")[0].rpartition("/")[2]
    if NAME.fullmatch(channel) is None:
        raise row.wrong("img_path", "<folder>/<CHANNEL>/<file>")
    pose = row.part("ego_pose").pose_numbers(FARTHEST_POSE_M)
    row.part("extrinsic").pose(FARTHEST_MOUNT_M)
    row.lens((1, 1), "intrinsic")
    camera = scene.cameras.setdefault(channel, AnnotatedCamera(row))
    if camera.frames and camera.frames[-1] == len(scene.tokens):
        raise DatasetFaultError("DST-037", row.place, f"two images have the channel {channel}")
    if any(camera.first.value(key) != row.value(key) for key in ("intrinsic", "extrinsic")):
        raise DatasetFaultError(
            "DST-038", row.place, f"{channel} has a different intrinsic or extrinsic than in earlier frames"
        )
    camera.frames.append(len(scene.tokens))
    name_parts = channel_and_stamp(name)
    camera.stamps_ns.append((stamp_us if name_parts is None else name_parts[1]) * NS_PER_US)
    camera.poses.append(pose)
    camera.rows.append(len(names))
    names.add(next((f"{at}{name}" for at in PICTURE_FOLDERS if files.span(f"{at}{name}") is not None), name))


def _sequence(files: DatasetFiles, scene: AnnotatedScene, names: NameColumn) -> DatasetSequence:
    order = np.argsort(np.array(scene.stamps_us, np.int64))
    rank = np.argsort(order)
    poses = SE3(np.array(scene.poses, np.float64).reshape(-1, 7)[order])
    stamps_ns = np.array(scene.stamps_us, np.int64)[order] * NS_PER_US
    tokens = tuple(scene.tokens[index].replace("-", "") for index in order.tolist())
    channels = {name: _channel(files, name, camera, (names, rank)) for name, camera in scene.cameras.items()}
    is_labelled = files.has_folder(label_folder(scene.name))
    return DatasetSequence(scene.name, "", "", "", tokens, stamps_ns, poses, channels, is_labelled)


def _channel(files: DatasetFiles, name: str, camera: AnnotatedCamera, of: tuple[NameColumn, object]) -> DatasetChannel:
    names, rank = of
    frames = np.asarray(rank)[camera.frames]
    order, first = np.argsort(frames), files.span(names[camera.rows[0]])
    lens = None
    if first is not None:
        _, size_px = picture_of(first, camera.first.place)
        lens = camera.first.lens(size_px, "intrinsic")
    sensor = ExportedSensor(name, "camera", camera.first.part("extrinsic").pose(FARTHEST_MOUNT_M), lens)
    held = (np.array(camera.stamps_ns, np.int64)[order], SE3(np.array(camera.poses, np.float64)[order]))
    return DatasetChannel(sensor, frames[order], *held, np.array(camera.rows, np.int64)[order], names)


# Creates tables for a scene in Occ3D's layout from its annotations. Tokens are the first 32 hex digits of the sha256 of
# a row's content; a frame keeps its own. Images are named `samples/<CHANNEL>/<scene>__<CHANNEL>__<µs>.<ending>`,
# because the layout's own names have no fixed form. The layout has no LiDAR, so the tables have no LiDAR rows.


CLASSES = ("free", "traversable", "potentially_traversable", "non_traversable")
MOST_BYTES = 1 << 40  # per scene: a few times the size of its annotations
Row = Mapping[str, Any]


def write_annotated_tables(sequence: DatasetSequence, folder: Path) -> None:
    """Write the scene's tables into its folder. Raises `DST-035` if a camera's stamps do not increase."""
    out = SceneTableFiles(1, lambda _: folder, MOST_BYTES)
    rows = _rows(sequence)
    for table in TABLES:
        out.write(table, (((0,), encoded(row)) for row in rows.get(table, ())))


def picture_names(sequence: DatasetSequence, channel: DatasetChannel) -> tuple[str, ...]:
    """Return the names of a channel's files in the release's layout. Raises `DST-035`."""
    name, stamps_us = channel.sensor.channel, channel.stamps_ns // NS_PER_US
    if (np.diff(stamps_us) <= 0).any():
        position = DatasetPlace(f"{ANNOTATIONS} scene {sequence.name}")
        raise DatasetFaultError("DST-035", position, f"the stamps of {name} do not increase from frame to frame")
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
            {"token": _token("category", class_name), "name": class_name, "description": "", "index": index}
            for index, class_name in enumerate(CLASSES)
        ],
        "sensor": [
            {"token": _token("sensor", channel), "channel": channel, "modality": "camera"} for channel in channels
        ],
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
    lens_columns = {"camera_model": lens.model, "camera_distortion": list(lens.distortion)}
    return row | {"camera_intrinsic": matrix} | lens_columns


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


def _datum_token(sequence: DatasetSequence, channel: DatasetChannel, index: int) -> str:
    """Return the token of a datum; "" beyond the ends, as in the schema's chains."""
    if not 0 <= index < len(channel.frames):
        return ""
    return _token("sample_data", sequence.tokens[int(channel.frames[index])], channel.sensor.channel)


def _poses(sequence: DatasetSequence, channel: DatasetChannel) -> Iterator[Row]:
    for index, stamp_ns in enumerate(channel.stamps_ns.tolist()):
        token = _datum_token(sequence, channel, index)
        yield {"token": token, "timestamp": stamp_ns // NS_PER_US, **_posed(channel.map_from_ego[index])}


def _data(sequence: DatasetSequence, channel: DatasetChannel) -> Iterator[Row]:
    lens = channel.sensor.intrinsics
    size = (0, 0) if lens is None else (lens.height_px, lens.width_px)
    for index, name in enumerate(picture_names(sequence, channel)):
        token = _datum_token(sequence, channel, index)
        yield {
            "token": token,
            "sample_token": sequence.tokens[int(channel.frames[index])],
            "ego_pose_token": token,
            "calibrated_sensor_token": _token("calibrated_sensor", sequence.name, channel.sensor.channel),
            "timestamp": int(channel.stamps_ns[index]) // NS_PER_US,
            "fileformat": name.rpartition(".")[2],
            "is_key_frame": True,
            "height": size[0],
            "width": size[1],
            "filename": name,
            "prev": _datum_token(sequence, channel, index - 1),
            "next": _datum_token(sequence, channel, index + 1),
        }
