"""Why a calibration file is refused before its numbers are looked at: size, YAML, format, keys.

**Conventions.** Codes CAL-42x; what is wrong with the numbers is said by `stone.sensors.calibration_errors`.
"""

from collections.abc import Iterable

from stone.errors import StoneError


class CalibrationYamlError(StoneError):
    """The file is not the plain YAML that calibrations are written in."""

    code = "CAL-421"

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} is not a YAML calibration: {problem}")


class CalibrationKeyError(StoneError):
    """A key is missing, unknown, or holds a value of the wrong kind."""

    code = "CAL-422"

    def __init__(self, name: str, key: str, problem: str, more: int) -> None:
        also = f" (and {more} more)" if more else ""
        super().__init__(f"{name}: {key or 'the document'}: {problem}{also}")


class CalibrationFormatError(StoneError):
    """The file is none of the ten formats that are read."""

    code = "CAL-423"

    def __init__(self, name: str, looks_like: str) -> None:
        super().__init__(
            f"{name} looks like {looks_like}; read are the native format (`stone_calibration: 1`, see examples/), ROS "
            "camera_info, Kalibr camchain, OpenCalib, nuScenes calibrated_sensor, Autoware sensor_kit, KITTI calib, "
            "RELLIS-3D transforms, OpenCV matrices and /tf_static"
        )


class HalfRigError(StoneError):
    """The calibration is incomplete: the files describe only a part of the sensor rig."""

    code = "CAL-424"

    def __init__(self, name: str, missing: str, remedy: str) -> None:
        super().__init__(f"{name} is an incomplete sensor rig: {missing}; {remedy}")


class AmbiguousRigError(StoneError):
    """The files are ambiguous: several sensors or frames could be the one that is meant."""

    code = "CAL-425"

    def __init__(self, name: str, what: str, choices: Iterable[str], remedy: str) -> None:
        shown = ", ".join(list(choices)[:8])
        super().__init__(f"{name}: {what} could be any of {shown}; {remedy}")


class LensModelError(StoneError):
    """A camera is calibrated with a lens model that is not supported."""

    code = "CAL-427"

    def __init__(self, name: str, sensor: str, model: str) -> None:
        super().__init__(
            f"{name}: {sensor} has the lens model {model[:40]!r}; read are pinhole cameras with none, plumb_bob, "
            "radtan, rational_polynomial or equidistant distortion (calibrate again with one of them)"
        )


class ConflictingFilesError(StoneError):
    """Two files of one bundle contradict each other."""

    code = "CAL-429"

    def __init__(self, name: str, what: str, files: Iterable[str]) -> None:
        super().__init__(f"{name}: {' and '.join(files)} disagree about {what}; leave one of them out")


class ValidityError(StoneError):
    """A calibration would be valid at no time."""

    code = "CAL-418"

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name}: {problem}; it is valid from `valid_from` up to `valid_to`, either may be left out")
