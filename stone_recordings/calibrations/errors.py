"""Refusals of a calibration file before its numbers are read: size, YAML, format, keys.

**Conventions.** Codes CAL-42x; `stone.sensors.calibration_errors` is about the numbers.
"""

from collections.abc import Iterable

from stone.errors import Refused, StoneError


class CalibrationYamlError(StoneError):
    """The file is not the plain YAML of calibrations."""

    code = "CAL-421"

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} is not a YAML calibration: {problem}")


def bad_calibration_key(name: str, key: str, problem: str, more: int) -> Refused:
    also = f" (and {more} more)" if more else ""
    return Refused("CAL-422", f"{name}: {key or 'the document'}: {problem}{also}")


def half_rig(name: str, missing: str, remedy: str) -> Refused:
    return Refused("CAL-424", f"{name} is an incomplete sensor rig: {missing}; {remedy}")


def unread_lens_model(name: str, sensor: str, model: str) -> Refused:
    return Refused(
        "CAL-427",
        f"{name}: {sensor} has the lens model {model[:40]!r}; read are pinhole cameras with none, plumb_bob, "
        "radtan, rational_polynomial or equidistant distortion (calibrate again with one of them)",
    )


def conflicting_files(name: str, what: str, files: Iterable[str]) -> Refused:
    return Refused("CAL-429", f"{name}: {' and '.join(files)} disagree about {what}; leave one of them out")
