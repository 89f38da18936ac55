"""Why a calibration is refused: one leaf per fact, coded CAL-4xx as findings about calibrations are.

**Conventions.** `sensor` is the channel (CAM_FRONT, INS, …) or the transform (ego_from_lidar) the fact is about.
"""

from collections.abc import Iterable, Sequence

from stone.errors import StoneError


class NotARotationError(StoneError):
    """A 3×3 block is too far from any rotation to be one that was rounded."""

    code = "CAL-401"

    def __init__(self, sensor: str, determinant: float, residual: float, limit: float) -> None:
        super().__init__(
            f"{sensor}: the rotation is not a rotation (determinant {determinant:.4g}, error {residual:.3g}, "
            f"limit {limit:g}); was it scaled, or typed by hand?"
        )


class QuaternionNormError(StoneError):
    """A quaternion is too far from unit length to be one that was rounded."""

    code = "CAL-402"

    def __init__(self, sensor: str, norm: float, limit: float) -> None:
        super().__init__(
            f"{sensor}: the quaternion has norm {norm:.4g}; it must be 1 ± {limit:g} (a component missing or mistyped?)"
        )


class ImageSizeError(StoneError):
    """A camera was calibrated for images of another size than it recorded."""

    code = "CAL-403"

    def __init__(self, sensor: str, calibrated_px: tuple[int, int], recorded_px: tuple[int, int]) -> None:
        super().__init__(
            f"{sensor} is calibrated for {calibrated_px[0]}x{calibrated_px[1]} px, its images are "
            f"{recorded_px[0]}x{recorded_px[1]} px (binned, cropped or rescaled after calibration?)"
        )


class DisconnectedSensorError(StoneError):
    """No chain of transforms leads from a sensor to the LiDAR."""

    code = "CAL-405"

    def __init__(self, sensor: str, frame: str, lidar_frame: str) -> None:
        super().__init__(
            f"{sensor}: its frame {frame!r} has no path to the LiDAR's frame {lidar_frame!r} "
            "(a transform missing, or a frame called differently in two files?)"
        )


class NotFiniteError(StoneError):
    """A number is NaN or infinite."""

    code = "CAL-416"

    def __init__(self, sensor: str, what: str) -> None:
        super().__init__(f"{sensor}: {what} holds NaN or infinity; every number of a calibration is finite")


class LastRowError(StoneError):
    """The last row of a homogeneous matrix is not (0, 0, 0, 1)."""

    code = "CAL-407"

    def __init__(self, sensor: str, row: Sequence[float]) -> None:
        shown = ", ".join(f"{value:.4g}" for value in row)
        super().__init__(f"{sensor}: the last row of the matrix is ({shown}), not (0, 0, 0, 1); is it transposed?")


class MirrorError(StoneError):
    """A rotation block has a negative determinant: it turns a right hand into a left one."""

    code = "CAL-408"

    def __init__(self, sensor: str, determinant: float) -> None:
        super().__init__(
            f"{sensor}: the rotation has determinant {determinant:.4g}, so it mirrors; it must be +1 "
            "(one axis has the wrong sign, or two are swapped)"
        )


class TranslationError(StoneError):
    """A sensor sits farther from the LiDAR than any robot is long."""

    code = "CAL-409"

    def __init__(self, sensor: str, distance_m: float, limit_m: float) -> None:
        super().__init__(
            f"{sensor}: the translation is {distance_m:.4g} m long; the limit is {limit_m:g} m (in millimetres?)"
        )


class DistortionLengthError(StoneError):
    """The distortion vector has another length than its model has coefficients."""

    code = "CAL-410"

    def __init__(self, sensor: str, model: str, length: int, expected: int) -> None:
        super().__init__(
            f"{sensor}: {length} distortion coefficients for the model {model}, which has {expected} (another model?)"
        )


class CameraMatrixError(StoneError):
    """Focal lengths or principal point cannot belong to the image they are given for."""

    code = "CAL-411"

    def __init__(self, sensor: str, key: str, value: float, expected: str) -> None:
        super().__init__(f"{sensor}: {key} is {value:.6g} px; expected {expected} (rows and columns swapped?)")


class MissingSensorError(StoneError):
    """A sensor that the job needs is not in the calibration."""

    code = "CAL-412"

    def __init__(self, missing: Iterable[str], known: Iterable[str], why: str) -> None:
        super().__init__(
            f"the calibration has no {', '.join(missing)}, which {why} needs; it has {', '.join(known) or 'no sensor'}"
        )


class RepeatedSensorError(StoneError):
    """Two sensors of one calibration have the same channel."""

    code = "CAL-413"

    def __init__(self, sensor: str) -> None:
        super().__init__(f"{sensor} is in the calibration twice; channels are unique")


class FootprintError(StoneError):
    """A footprint or a self box has no extent, or more than a vehicle has."""

    code = "CAL-415"

    def __init__(self, what: str, value: str, expected: str) -> None:
        super().__init__(f"{what} is {value}; expected {expected}")
