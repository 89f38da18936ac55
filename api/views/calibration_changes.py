"""Differences between two stored calibrations, as response bodies."""

from dataclasses import asdict

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller
from api.schemas.sequences.calibrations import CalibrationDiffItem
from api.views import calibration_reading
from api.visible import calibration_of
from services.runtime.orm import Blob, CalibrationRow
from services.runtime.platform import Platform
from stone.sensors.calibration_diff import difference


def changes(platform: Platform, caller: Caller, calibration_id: str, against: str | None) -> CalibrationDiffItem:
    """Return the changes from `against` (default: the previous version, or itself for the first) to the calibration."""
    with platform.database.reading() as session:
        row = calibration_of(session, caller, calibration_id)
        earlier = version_before(session, row) or row if against is None else calibration_of(session, caller, against)
        files = [
            (session.get_one(Blob, calibration.blob_sha256).object_key, calibration.filename)
            for calibration in (earlier, row)
        ]
        earlier_id = earlier.id
    before, after = (calibration_reading.read_stored(platform.store, key, name) for key, name in files)
    changed = difference(before, after)
    return CalibrationDiffItem.model_validate(
        {"id": calibration_id, "against": earlier_id, "is_same": changed.is_same, **asdict(changed)}
    )


def version_before(session: Session, row: CalibrationRow) -> CalibrationRow | None:
    """Return the previous version among its owner's calibrations of its name; None for the first."""
    of_name = select(CalibrationRow).where(CalibrationRow.owner_id == row.owner_id, CalibrationRow.name == row.name)
    earlier = of_name.where(CalibrationRow.version < row.version).order_by(CalibrationRow.version.desc()).limit(1)
    return session.scalars(earlier).first()
