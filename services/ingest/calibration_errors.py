"""Why a calibration file is refused before its numbers are looked at: size, YAML, format, keys.

**Conventions.** Codes CAL-42x; what is wrong with the numbers is said by `stone.calibration_errors`.
"""

from stone.errors import StoneError


class CalibrationSizeError(StoneError):
    """The file is larger than any calibration."""

    code = "CAL-420"

    def __init__(self, name: str, limit_bytes: int) -> None:
        super().__init__(f"{name} is larger than {limit_bytes} bytes; a calibration is a few kilobytes (another file?)")


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
    """The file is a calibration, but in another format than is read."""

    code = "CAL-423"

    def __init__(self, name: str, looks_like: str) -> None:
        super().__init__(
            f"{name} looks like {looks_like}; only the native format is read, "
            "a YAML file that begins with `stone_calibration: 1` (see examples/)"
        )
