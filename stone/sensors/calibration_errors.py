"""Refusals of calibrations, with the codes CAL-4xx of findings about calibrations.

**Conventions.** `sensor` is the affected channel (CAM_FRONT, INS, …) or transform (ego_from_lidar).
"""

from collections.abc import Iterable

from stone.errors import Refused, StoneError


class ImageSizeError(StoneError):
    """A camera's calibrated image size differs from its recorded one."""

    code = "CAL-403"

    def __init__(self, sensor: str, calibrated_px: tuple[int, int], recorded_px: tuple[int, int]) -> None:
        super().__init__(
            f"{sensor} is calibrated for {calibrated_px[0]}x{calibrated_px[1]} px, but its images have "
            f"{recorded_px[0]}x{recorded_px[1]} px (binned, cropped or rescaled after calibration?)"
        )


def not_finite(sensor: str, what: str) -> Refused:
    return Refused("CAL-416", f"{sensor}: {what} contains NaN or infinity; all numbers of a calibration must be finite")


def distortion_length(sensor: str, model: str, length: int, expected: int) -> Refused:
    return Refused(
        "CAL-410",
        f"{sensor}: {length} distortion coefficients for the model {model}, which requires {expected} (another model?)",
    )


class MissingSensorError(StoneError):
    """A sensor that the job requires is not in the calibration."""

    code = "CAL-412"

    def __init__(self, missing: Iterable[str], known: Iterable[str], why: str) -> None:
        super().__init__(
            f"the calibration has no {', '.join(missing)}, which {why} requires; it has "
            f"{', '.join(known) or 'no sensor'}"
        )
