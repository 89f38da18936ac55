"""Calibrations as the API and the pages show them: rows become bodies."""

from api.schemas.base import instant, instant_or_none
from api.schemas.sequences.calibrations import CalibrationItem, FindingItem, SensorItem
from services.runtime.orm import CalibrationRow


def calibration_item(row: CalibrationRow) -> CalibrationItem:
    """A calibration with its sensors and what was noticed about it."""
    return CalibrationItem(
        id=row.id,
        owner_id=row.owner_id,
        name=row.name,
        version=row.version,
        filename=row.filename,
        sha256=row.sha256,
        format=row.format,
        valid_from=instant_or_none(row.valid_from_ns),
        valid_to=instant_or_none(row.valid_to_ns),
        sensors=[SensorItem(**sensor) for sensor in row.sensors],
        findings=[FindingItem(**finding) for finding in row.findings],
        created_at=instant(row.created_ns),
    )
