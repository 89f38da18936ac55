"""The file format of a synchronised sequence, written by ingest and read by the labeler.

**Conventions.** An npz of plain arrays: stamps, poses and their quality, the track between them, and per channel the
message index and dt, or the starts of its slices. Everything else is JSON in the bytes of `record`. Floats survive
exactly (JSON writes the shortest digits that read back the same). Tokens derived from name and stamps are not stored;
tokens of a published dataset are in `tokens` of the record. Workers of one version write and read it; exports of that
version also read it beside labels on disk.
"""

import io
import json
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.ground_plane import GroundFit
from stone.sensors.height_drift import HeightDrift
from stone.sensors.pose_quality import PoseQuality
from stone.sensors.sequence import Association, ExcludedFrame, Frames, RecordingClock, Sequence, Slices, frame_token
from stone_files.npz import npz_bytes
from stone_recordings.calibrations.record import calibration_of, calibration_record

Arrays = dict[str, NDArray[Any]]
QUALITY = ("gap_ns", "rtk", "stdev_m")


def sequence_bytes(sequence: Sequence) -> bytes:
    """Return the file; equal sequences give equal bytes."""
    frames = sequence.frames
    arrays: Arrays = {
        "record": np.frombuffer(json.dumps(_record(sequence)).encode(), np.uint8),
        "stamps_ns": frames.stamps_ns,
        "map_from_ego": frames.map_from_ego.wxyz_xyz,
    }
    for number, taken in enumerate(frames.associations.values()):
        arrays |= {f"index_{number}": taken.message_index, f"dt_ns_{number}": taken.dt_ns}
    for number, between in enumerate(frames.slices.values()):
        arrays[f"start_{number}"] = between.start
    if frames.quality is not None:
        arrays |= {f"quality_{name}": values for name, values in vars(frames.quality).items()}
    if frames.sweeps is not None:
        arrays["sweep_index"] = frames.sweeps.message_index
    if sequence.track is not None:
        arrays |= {"track_stamps_ns": sequence.track.stamps_ns, "track": sequence.track.map_from_ego.wxyz_xyz}
    if sequence.track is not None and sequence.track.segment is not None:
        arrays["track_segment"] = sequence.track.segment
    return npz_bytes(arrays)


def read_sequence(payload: bytes) -> Sequence:
    """Read the sequence that `sequence_bytes` wrote."""
    with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
        record = json.loads(arrays["record"].tobytes())
        frames, track = _frames(record, dict(arrays)), _track(dict(arrays))
    return Sequence(
        name=record["name"],
        frames=frames,
        excluded=tuple(ExcludedFrame(**frame) for frame in record["excluded"]),
        calibration=calibration_of(record["calibration"]),
        pose_source=record["pose_source"],
        map_origin_deg_m=_floats(record["map_origin_deg_m"]),
        inputs=record["inputs"],
        findings=tuple(Finding(**finding) for finding in record["findings"]),
        track=track,
        max_pose_gap_ns=record["max_pose_gap_ns"],
        map_of_segment=tuple(record["map_of_segment"]),
        ground=GroundFit(**record["ground"]) if record["ground"] else None,
        height_drift=HeightDrift(**record["height_drift"]) if record["height_drift"] else None,
        recordings=tuple(
            RecordingClock(name, offset_ns, sigma_ns, tuple(known_by))
            for name, offset_ns, sigma_ns, known_by in record.get("recordings", ())
        ),
    )


def _track(arrays: Arrays) -> Trajectory | None:
    if "track" not in arrays:
        return None
    return Trajectory(arrays["track_stamps_ns"], SE3(arrays["track"]), arrays.get("track_segment"))


def _frames(record: dict[str, Any], arrays: Arrays) -> Frames:
    stamps_ns = arrays["stamps_ns"]
    sweeps, quality = record["sweeps"], [arrays.get(f"quality_{name}") for name in QUALITY]
    return Frames(
        stamps_ns,
        tuple(record.get("tokens", _derived_tokens(record["name"], stamps_ns))),
        SE3(arrays["map_from_ego"]),
        {
            channel: Association(topic, arrays[f"index_{number}"], arrays[f"dt_ns_{number}"], phase_ns)
            for number, (channel, topic, phase_ns) in enumerate(record["associations"])
        },
        {channel: Slices(topic, arrays[f"start_{number}"]) for number, (channel, topic) in enumerate(record["slices"])},
        None if any(values is None for values in quality) else PoseQuality(*quality),  # type: ignore[arg-type]
        None if sweeps is None else Association(sweeps, arrays["sweep_index"], np.zeros(len(stamps_ns), np.int64)),
    )


def _record(sequence: Sequence) -> dict[str, Any]:
    frames = sequence.frames
    are_derived = frames.tokens == _derived_tokens(sequence.name, frames.stamps_ns)
    return {
        "name": sequence.name,
        **({} if are_derived else {"tokens": list(frames.tokens)}),
        "associations": [[key, taken.topic, taken.phase_ns] for key, taken in frames.associations.items()],
        "slices": [[key, between.topic] for key, between in frames.slices.items()],
        "sweeps": frames.sweeps.topic if frames.sweeps is not None else None,
        "excluded": [asdict(frame) for frame in sequence.excluded],
        "calibration": calibration_record(sequence.calibration),
        "pose_source": sequence.pose_source,
        "map_origin_deg_m": sequence.map_origin_deg_m,
        "inputs": dict(sequence.inputs),
        "findings": [finding.as_record() for finding in sequence.findings],
        "max_pose_gap_ns": sequence.max_pose_gap_ns,
        "map_of_segment": list(sequence.map_of_segment),
        "ground": asdict(sequence.ground) if sequence.ground else None,
        "height_drift": asdict(sequence.height_drift) if sequence.height_drift else None,
        "recordings": [
            [recording.name, recording.offset_ns, recording.sigma_ns, recording.known_by]
            for recording in sequence.recordings
        ],
    }


def _derived_tokens(name: str, stamps_ns: NDArray[np.int64]) -> tuple[str, ...]:
    return tuple(frame_token(name, stamp) for stamp in stamps_ns.tolist())


def _floats(values: list[float] | None) -> tuple[float, float, float] | None:
    return None if values is None else (values[0], values[1], values[2])
