"""Why an output cannot be written."""

from pathlib import Path
from typing import ClassVar

from stone.errors import StoneError


class OutputExistsError(StoneError):
    """Something that is not ours to replace stands where the output should go."""

    code: ClassVar[str] = "output_exists"

    def __init__(self, path: Path, found: str) -> None:
        super().__init__(f"{path} is {found}; choose another output path, or remove it first")
