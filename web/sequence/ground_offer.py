"""The correction that is offered before a sequence is processed, if its ground is not where the calibration has it.

**Conventions.** The ground of a recording was measured in the LiDAR's frame when it was registered, so any calibration
can be held against it. A calibration that cannot be read any more is for processing to refuse.
"""

from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.views.calibration_reading import stored
from services.runtime.orm import Blob, CalibrationRow, Recording, SequenceRow
from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.sensors.ground_plane import GroundFit

MOST_READ = 50
OFF_M = 0.15  # the band of the footprint: farther off, nothing is labelled
_FIT = TypeAdapter(GroundFit)


@dataclass(frozen=True)
class GroundOffer:
    """How far the ground lies above the ego origin (m), and the height at which the LiDAR is mounted by it (m)."""

    height_m: float
    lidar_height_m: float


def ground_offer_of(platform: Platform, sequence_id: str) -> GroundOffer | None:
    """None if the ground is where it should be, or nobody knows."""
    with platform.database.reading() as session:
        found = _found(session, session.get_one(SequenceRow, sequence_id))
    if found is None:
        return None
    try:
        ego_from_lidar = stored(platform.store, found.object_key, found.filename).ego_from_lidar
        ground = _FIT.validate_python(found.ground).seen_from(ego_from_lidar)
    except (StoneError, ValidationError):
        return None
    if abs(ground.height_m) <= OFF_M or not ground.is_off_in_all:
        return None
    return GroundOffer(ground.height_m, float(ground.untilted().corrected(ego_from_lidar).translation_m[2]))


@dataclass(frozen=True)
class _Found:
    """A ground as its recording's row has it, and where the calibration lies."""

    ground: Any
    object_key: str
    filename: str


def _found(session: Session, sequence: SequenceRow) -> _Found | None:
    registered = select(Recording.inspection).where(
        Recording.sequence_id == sequence.id, Recording.state == "registered"
    )
    records = session.scalars(registered.order_by(Recording.id).limit(MOST_READ)).all()
    fits = [fit for fit in ((record or {}).get("lidar_ground") for record in records) if fit]
    row = session.get(CalibrationRow, sequence.calibration_id) if sequence.calibration_id else None
    if row is None or not fits:
        return None
    return _Found(fits[0], session.get_one(Blob, row.blob_sha256).object_key, row.filename)
