"""Refusals of this program: an unusable description, a folder without any described recording."""

from pathlib import Path

from stone.errors import StoneError


class DescriptionError(StoneError):
    """A description of a recording is unusable."""

    code = "bad_description"

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(f"{path.name}: {problem}")


class NothingDescribedError(StoneError):
    """A given folder does not exist, or contains no recording with a description."""

    code = "nothing_described"

    def __init__(self, folder: Path, known: int) -> None:
        if not folder.is_dir():
            super().__init__(f"{folder} is not an existing folder; check the path")
            return
        super().__init__(
            f"{folder} holds no file *.real.yaml, and none of the recordings of the {known} descriptions in "
            "the project. Check the folder; docs/research/real-ground.md defines the descriptions"
        )
