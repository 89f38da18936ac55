"""Totals of a label set for its database row: duration, distance, voxels by class; and the driven track."""

from dataclasses import asdict

import numpy as np
import pymap3d

from services.labeler.child_answers import LONGEST_WORD, TrackAnswer
from services.labeler.results import load_pack
from services.labeler.run import LabelRun, parts_of
from services.labeler.tables import CLASS_COLUMNS, concatenated
from stone.geometry.se3 import SE3
from stone.sensors.sequence import Sequence
from stone.splits.composition import duration_ns, path_length_m
from stone.splits.drives import TrackOrigin, driven_track
from stone_recordings.poses.ins_poses import ecef_from_enu_wxyz

Totals = dict[str, int | float]
EARTH = "earth"  # WGS 84, earth-centred


def totals_of(run: LabelRun) -> Totals:
    """Return the totals by column name, from the packs in scratch."""
    counts = concatenated([load_pack(run, part)[1] for part in parts_of(run)])
    voxels = dict(zip(CLASS_COLUMNS, counts.classes.sum(axis=0).tolist(), strict=True))
    frames = run.sequence.frames
    distance_m = path_length_m(frames.map_from_ego.translation_m)
    return {"duration_ns": duration_ns(frames.stamps_ns), "distance_m": distance_m, **voxels}


def recorded_track(sequence: Sequence) -> TrackAnswer | None:
    """Return the track of a recording: on the earth if its poses are georeferenced, else in its own map."""
    return track_of(sequence, *common_map(sequence.map_origin_deg_m, sequence.calibration.name))


def common_map(origin_deg_m: tuple[float, float, float] | None, vehicle: str) -> tuple[TrackOrigin, SE3]:
    """Return the map in which tracks of a vehicle are compared, and the pose of its own map with this origin in it."""
    if origin_deg_m is None:
        return TrackOrigin(vehicle=vehicle), SE3.identity()
    latitude_deg, longitude_deg, height_m = origin_deg_m
    wxyz = ecef_from_enu_wxyz(np.array(latitude_deg), np.array(longitude_deg))
    earth_from_map = SE3.from_parts(wxyz, np.array(pymap3d.geodetic2ecef(latitude_deg, longitude_deg, height_m)))
    return TrackOrigin(vehicle=vehicle, map=EARTH), earth_from_map


def track_of(sequence: Sequence, origin: TrackOrigin, common_from_map: SE3) -> TrackAnswer | None:
    """Return the track of a sequence in the map that `origin` names; None without frames."""
    frames = sequence.frames
    words = (word[:LONGEST_WORD] for word in (origin.log, origin.vehicle, origin.map))
    positions = common_from_map @ frames.map_from_ego.translation_m
    track = driven_track(frames.stamps_ns, positions, TrackOrigin(*words))
    return TrackAnswer(**asdict(track)) if track else None
