"""`<sequence>.mcap`: the labelled sequence for Foxglove, in its own message schemas.

| topic | schema | frame_id |
|---|---|---|
| /tf | foxglove.FrameTransforms: map → ego → LIDAR → every sensor | |
| /labels | foxglove.VoxelGrid: red green blue alpha, and class | ego |
| /LIDAR | foxglove.PointCloud: x y z intensity ring | LIDAR |
| /RADAR_… | foxglove.PointCloud: x y z range_rate ground_rate rcs | the channel |
| /CAM_…/image, /CAM_…/calibration | foxglove.CompressedImage, foxglove.CameraCalibration | the channel |
| /track | foxglove.PosesInFrame: every pose, once | map |
| /map/mesh/0, 1, … | foxglove.SceneUpdate: a part of the mesh each, once | map |

**Conventions.** What is logged of a sensor carries the stamp at which it measured, also as its log time; a frame's
messages are in the order of theirs. Chunks are zstd, indexed. One thread and no clock: equal inputs give equal bytes.
What does not change has a topic of its own for each piece, because a viewer that jumps looks for the last message of a
topic. Source: docs.foxglove.dev, MCAP specification.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foxglove import Context, channels, open_mcap
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import FoxgloveMessage

from services.labeler.exports.foxglove_messages import (
    LIDAR,
    camera_calibration,
    image,
    lidar_cloud,
    mesh_update,
    radar_cloud,
    track,
    transforms,
    voxel_grid,
)
from services.labeler.exports.mesh_parts import mesh_parts
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step, silent

CHUNK_BYTES = 4 << 20

Logged = tuple[int, str, FoxgloveMessage]  # log time ns, topic, message


def write_foxglove(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write the file into the folder `out`. Raises what the source raises."""
    total = len(source.sequence.frames)
    options = MCAPWriteOptions(chunk_size=CHUNK_BYTES, compression_threads=0)
    log = _Log(Context())
    with open_mcap(out / f"{source.sequence.name}.mcap", context=log.context, writer_options=options):
        step(0, total)
        for logged in _once(source):
            log.write(logged)
        for index in range(total):
            for logged in sorted(_frame(source, index), key=lambda one: one[0]):
                log.write(logged)
            step(index + 1, total)


class _Log:
    """A channel of the message's schema for every topic, made at its first message."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._channels: dict[str, Any] = {}  # each has a class of its own, without a base

    def write(self, logged: Logged) -> None:
        log_time_ns, topic, message = logged
        if topic not in self._channels:
            made = getattr(channels, f"{type(message).__name__}Channel")
            self._channels[topic] = made(topic, context=self.context)
        self._channels[topic].log(message, log_time=log_time_ns)


def _once(source: LabelledSequence) -> Iterator[Logged]:
    """What holds for the whole sequence, at its first stamp; nothing of a sequence without frames."""
    frames = source.sequence.frames
    if len(frames):
        first_ns = int(frames.stamps_ns[0])
        yield first_ns, "/track", track(frames.map_from_ego, first_ns)
        for number, part in enumerate(mesh_parts(source.mesh)):
            yield first_ns, f"/map/mesh/{number}", mesh_update(part, number, first_ns)


def _frame(source: LabelledSequence, index: int) -> Iterator[Logged]:
    frames, calibration = source.sequence.frames, source.sequence.calibration
    stamp_ns = int(frames.stamps_ns[index])
    yield stamp_ns, "/tf", transforms(calibration, frames.map_from_ego[index], stamp_ns)
    yield stamp_ns, "/labels", voxel_grid(source.grids(index)["semantics"], stamp_ns)
    yield stamp_ns, f"/{LIDAR}", lidar_cloud(source.samples.lidar(index), stamp_ns)
    for mount in calibration.of_kind("radar"):
        if (scan := source.samples.radar(mount.name, index)) is not None:
            yield scan.stamp_ns, f"/{mount.name}", radar_cloud(mount.name, scan)
    for mount in calibration.of_kind("camera"):
        if (picture := source.samples.camera(mount.name, index)) is not None:
            yield picture.stamp_ns, f"/{mount.name}/image", image(mount.name, picture)
            if mount.intrinsics is not None:
                message = camera_calibration(mount.name, mount.intrinsics, picture.stamp_ns)
                yield picture.stamp_ns, f"/{mount.name}/calibration", message
