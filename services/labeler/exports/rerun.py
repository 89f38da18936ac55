"""`<sequence>.rrd`: the labelled sequence for the Rerun viewer, with the view it opens in.

    map                         z up
    map/track, map/mesh/0, …    where the robot drove; the surface of the whole run, hidden at first
    map/ego                     the robot's pose
    map/ego/labels              the labelled voxels
    map/ego/LIDAR               the sweep
    map/ego/LIDAR/CAM_…         the camera, its lens and its picture
    map/ego/LIDAR/RADAR_…       the detections, in the LiDAR's axes

**Conventions.** Two timelines: `frame` (number) and `stamp` (UTC, ns); a picture stands at its frame and at its own
stamp. One frame is in memory at a time. Chunks and rows have ids made of their order, so equal inputs give equal
chunks; the order of the keys within a chunk is Rerun's, and differs from process to process.
"""

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from services.labeler.exports import rerun_entities as entities
from services.labeler.exports.mesh_parts import mesh_parts
from services.labeler.exports.rerun_entities import Columns
from services.labeler.exports.source import LabelledSequence
from services.labeler.run import Step, silent
from stone.sensors.sequence import Sequence

APPLICATION = "stone"
MAP, EGO, LIDAR = "/map", "/map/ego", "/map/ego/LIDAR"
LABELS, TRACK, MESH = "/map/ego/labels", "/map/track", "/map/mesh"
ROW_ID, CHUNK_ID = "rerun.controls.RowId", b"rerun:id"
RING = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
USUAL_RATE_HZ = 10.0
EYE_EGO_M, LOOK_EGO_M = (-16.0, 6.0, 11.0), (3.0, 0.0, 0.0)


def write_rerun(source: LabelledSequence, out: Path, step: Step = silent) -> None:
    """Write the file into the folder `out`. Raises what the source raises."""
    rr.set_strict_mode(True)  # else what Rerun cannot take is only warned of, and missing in the file
    total = len(source.sequence.frames)
    recording = rr.RecordingStream(APPLICATION, recording_id=source.sequence.name, send_properties=False)
    numbers = count(1)
    try:
        recording.save(out / f"{source.sequence.name}.rrd", default_view(source.sequence))
        step(0, total)
        recording.send_chunks(_numbered(chunk, next(numbers)) for chunk in _once(source))
        for index in range(total):
            recording.send_chunks(_numbered(chunk, next(numbers)) for chunk in _frame(source, index))
            step(index + 1, total)
        recording.flush()
    finally:
        recording.disconnect()


def default_view(sequence: Sequence) -> rrb.Blueprint:
    """The world between the cameras that look ahead and those that look back, playing as fast as it was recorded."""
    world = rrb.Spatial3DView(
        origin=EGO,
        contents=f"{MAP}/**",
        name="labels",
        overrides={MESH: rrb.EntityBehavior(visible=False)},
        eye_controls=rrb.EyeControls3D(position=EYE_EGO_M, look_target=LOOK_EGO_M, eye_up=(0.0, 0.0, 1.0)),
    )
    mounts = sequence.calibration.of_kind("camera")
    cameras = [
        rrb.Spatial2DView(origin=f"{LIDAR}/{name}", contents="$origin", name=name)
        for name in sorted((mount.name for mount in mounts), key=_place_in_ring)
    ]
    ahead, back = rrb.Horizontal(*cameras[:3]), rrb.Horizontal(*cameras[3:])
    return rrb.Blueprint(
        rrb.Vertical(ahead, world, back, row_shares=[1, 2.2, 1]) if cameras else world,
        rrb.TimePanel(state="collapsed", timeline="frame", fps=_rate_hz(sequence)),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _place_in_ring(name: str) -> tuple[int, str]:
    return (RING.index(name) if name in RING else len(RING), name)


def _rate_hz(sequence: Sequence) -> float:
    """How many frames a second the recording has, as a rule."""
    steps_ns = np.diff(sequence.frames.stamps_ns)
    return float(1e9 / np.median(steps_ns)) if len(steps_ns) else USUAL_RATE_HZ


def _once(source: LabelledSequence) -> Iterator[Chunk]:
    """What holds for the whole sequence."""
    sequence = source.sequence
    yield _static(MAP, rr.ViewCoordinates.columns(xyz=[rr.components.ViewCoordinates.RIGHT_HAND_Z_UP]))
    yield _static(LABELS, entities.labels_context())
    yield _static(TRACK, entities.track(sequence.frames.map_from_ego.translation_m))
    yield _static(LIDAR, entities.transform(sequence.calibration.ego_from_lidar))
    for mount in sequence.calibration.of_kind("camera"):
        path = f"{LIDAR}/{mount.name}"
        yield _static(path, entities.transform(mount.lidar_from_sensor))
        if mount.intrinsics is not None:
            yield _static(path, entities.pinhole(mount.intrinsics))
    for number, part in enumerate(mesh_parts(source.mesh)):
        yield _static(f"{MESH}/{number}", entities.mesh(part))


def _frame(source: LabelledSequence, index: int) -> Iterator[Chunk]:
    frames, calibration = source.sequence.frames, source.sequence.calibration
    times = _times(index, int(frames.stamps_ns[index]))
    yield Chunk.from_columns(EGO, times, entities.transform(frames.map_from_ego[index]))
    yield Chunk.from_columns(LABELS, times, entities.voxels(source.grids(index)["semantics"]))
    yield Chunk.from_columns(LIDAR, times, entities.returns(source.samples.lidar(index)))
    for mount in calibration.of_kind("radar"):
        if (scan := source.samples.radar(mount.name, index)) is not None:
            yield Chunk.from_columns(f"{LIDAR}/{mount.name}", times, entities.detections(scan))
    for mount in calibration.of_kind("camera"):
        if (taken := source.samples.camera(mount.name, index)) is not None:
            at = _times(index, taken.stamp_ns)
            yield Chunk.from_columns(f"{LIDAR}/{mount.name}", at, entities.picture(taken.content))


def _static(path: str, columns: Columns) -> Chunk:
    return Chunk.from_columns(path, [], columns)


def _times(index: int, stamp_ns: int) -> list[rr.TimeColumn]:
    stamp = np.array([stamp_ns], "datetime64[ns]")
    return [rr.TimeColumn("frame", sequence=[index]), rr.TimeColumn("stamp", timestamp=stamp)]


def _numbered(chunk: Chunk, number: int) -> Chunk:
    """The chunk, of one row, under ids that follow from its number, not from the clock."""
    batch = chunk.to_record_batch()
    row = pa.array([number.to_bytes(16, "big")], pa.binary(16))
    columns = [row if name == ROW_ID else batch.column(name) for name in batch.schema.names]
    named = {**(batch.schema.metadata or {}), CHUNK_ID: b"chunk_%032X" % number}
    renamed = pa.RecordBatch.from_arrays(columns, schema=batch.schema.with_metadata(named))
    return Chunk.from_record_batch(renamed)[0]
