"""Why an output cannot be written."""

from pathlib import Path
from typing import ClassVar

from stone_base.errors import StoneError


class OutputExistsError(StoneError):
    """The output path holds something that the command did not write."""

    code: ClassVar[str] = "output_exists"

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(f"{path} is {found}; choose another output path, or remove it first")


class CalibrationSizeError(StoneError):
    """The file is larger than any calibration."""

    code = "CAL-420"

    def __init__(self, name: str, limit_bytes: int) -> None:
        super().__init__(f"{name} is larger than {limit_bytes} bytes; a calibration is a few kilobytes (another file?)")


class CalibrationBundleError(StoneError):
    """A zip or folder is not a bundle of calibration files."""

    code = "CAL-428"

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} is not a bundle of calibration files: {problem}")
