"""Calibrations as the API and the pages show them: rows become bodies."""

from api.schemas.sequences.calibrations import CalibrationItem
from services.runtime.orm import CalibrationRow


def calibration_item(row: CalibrationRow) -> CalibrationItem:
    """A calibration with its sensors and what was noticed about it."""
    return CalibrationItem.of(row, valid_from=row.valid_from_ns, valid_to=row.valid_to_ns)
