"""The correction that is offered before a sequence is processed, if its ground is not where the calibration has it.

**Conventions.** The ground of a recording was measured in the LiDAR's frame when it was registered, so any calibration
can be held against it. A calibration that cannot be read any more is for processing to refuse.
"""

from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.views.calibration_reading import read_stored
from services.domain.sequences.processing import GIVEN_GROUND, ProcessRequest
from services.runtime.orm import Blob, CalibrationRow, Recording, SequenceRow
from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone.sensors.ground_plane import BAND_M, GroundFit, is_off_ground, surely_off_ground

MOST_READ = 50
_FIT = TypeAdapter(GroundFit)


@dataclass(frozen=True)
class GroundOffer:
    """The ground in the ego frame, by the calibration's mount of the LiDAR."""

    ground: GroundFit
    ego_from_lidar: SE3

    @property
    def height_m(self) -> float:
        """The height of the ground above the ego origin."""
        return self.ground.height_m

    @property
    def lidar_height_m(self) -> float:
        """The height at which the LiDAR is mounted by it."""
        return float(self.ground.untilted().corrected(self.ego_from_lidar).translation_m[2])


def ground_offer_of(platform: Platform, sequence_id: str) -> GroundOffer | None:
    """Return the offered correction; None if the ground lies as expected, or its height is unknown."""
    with platform.database.reading() as session:
        seen = _found(session, session.get_one(SequenceRow, sequence_id))
    if seen is None:
        return None
    try:
        ego_from_lidar = read_stored(platform.store, seen.object_key, seen.filename).ego_from_lidar
        ground = _FIT.validate_python(seen.ground).seen_from(ego_from_lidar)
    except (StoneError, ValidationError):
        return None
    return GroundOffer(ground, ego_from_lidar) if is_off_ground(ground) else None


def require_ground(platform: Platform, sequence_id: str, asked: ProcessRequest) -> None:
    """Raises `footprint_off_ground` for labels without the correction that is offered, if the ground is surely off.

    A ground that is nearer, and that of recordings or of a LiDAR which are chosen by name, is for the run to measure.
    """
    is_chosen = asked.lidar_topic is not None or asked.recording_ids
    if asked.ground != GIVEN_GROUND or "label" not in asked.stages or is_chosen:
        return
    offer = ground_offer_of(platform, sequence_id)
    if offer is None:
        return
    band_m = asked.parameters.get("footprint_band_m", BAND_M)
    refusal = surely_off_ground(offer.ground, offer.ego_from_lidar, band_m)
    if refusal is not None:
        raise refusal


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
