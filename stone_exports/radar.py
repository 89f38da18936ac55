"""Radar scans of an export: binary PCD with the fields of nuScenes, as features of models.

**Conventions.** A detection's velocity is the rate along its ray in plan, less what the robot's own motion makes of it
(`vx_comp`, `vy_comp`), turned into the ego frame. A 4D radar measures elevation, so z is measured too. Fields are found
by name, whatever their order; a scan without a detection holds one row of NaN. Source: `RadarPointCloud.from_file` of
nuscenes-devkit 1.2; the fields that a 4D radar fills: docs/formats/exports.md.
"""

import re

import numpy as np
from numpy.typing import NDArray

from stone_exports.files import ExportContent
from stone_exports.frames import ExportedDatum

MOST_SCAN_BYTES, MOST_HEAD_BYTES = 16 * 2**20, 4096
KINDS = {
    ("F", 4): "<f4",
    ("F", 8): "<f8",
    ("I", 1): "i1",
    ("I", 2): "<i2",
    ("I", 4): "<i4",
    ("U", 1): "u1",
    ("U", 2): "<u2",
}
WANTED = ("x", "y", "z", "rcs", "vx_comp", "vy_comp")
FARTHEST_DETECTION_M = 1e4


def detections_ego(datum: ExportedDatum) -> NDArray[np.float32]:
    """Rows (N, 6): x y z metres, RCS in dBsm, v_x v_y in m/s over ground, in the ego frame when it measured.

    Raises `DamagedExportError`.
    """
    records = scan_records(datum.span)
    rows = np.stack([records[name].astype(np.float64) for name in WANTED], axis=1)
    rows = rows[(np.abs(rows) < FARTHEST_DETECTION_M).all(axis=1)]
    ego_from_radar = datum.sensor.ego_from_sensor
    velocities = np.pad(rows[:, 4:], ((0, 0), (0, 1))) @ ego_from_radar.rotation().T
    return np.concatenate([ego_from_radar @ rows[:, :3], rows[:, 3:4], velocities[:, :2]], axis=1).astype(np.float32)


def scan_records(span: ExportContent) -> NDArray[np.void]:
    """The records of a binary PCD, with the fields that detections need. Raises `DamagedExportError`."""
    content = span.read(MOST_SCAN_BYTES)
    head, mark, body = content[:MOST_HEAD_BYTES].partition(b"DATA binary\n")
    if not mark:
        raise span.damaged("it is not a binary PCD")
    said = dict(re.findall(r"^([A-Z]+) (.*)$", head.decode("ascii", "replace"), re.MULTILINE))
    try:
        points, counts = int(said["POINTS"]), set(said.get("COUNT", "1").split())
        parts = zip(said["FIELDS"].split(), said["TYPE"].split(), said["SIZE"].split(), strict=True)
        record = np.dtype([(name, KINDS[kind, int(size)]) for name, kind, size in parts])
    except (KeyError, ValueError) as error:
        raise span.damaged("the header of the PCD is not valid") from error
    body = content[len(head) + len(mark) :]
    if counts != {"1"}:
        raise span.damaged("a field of it has several values")
    if missing := [name for name in WANTED if name not in (record.names or ())]:
        raise span.damaged(f"it has no field {missing[0]!r}")
    if not 0 <= points <= len(body) // record.itemsize:
        raise span.damaged(
            f"its header declares {points} detections, there are bytes for {len(body) // record.itemsize}"
        )
    return np.frombuffer(body, record, points)
