"""What is refused of exports as a whole."""

from collections.abc import Container, Mapping, Sequence
from typing import ClassVar

from stone.errors import StoneError


class FramesMissingError(StoneError):
    """The exports do not have all the frames that are to be predicted."""

    code: ClassVar[str] = "frames_missing"

    def __init__(self, missing: Sequence[str], sequences: Sequence[str]) -> None:
        super().__init__(
            f"{len(missing)} frames of the manifest have no sweep in what was given (the first is {missing[0]}); they "
            f"are of {', '.join(sequences[:5])}{', …' if len(sequences) > 5 else ''}: give the exports of those too"
        )


def refuse_missing(wanted: Mapping[str, Sequence[str]], found: Container[str]) -> None:
    """Raises `FramesMissingError` where a wanted frame token, by sequence, was not found."""
    without = {name: [token for token in tokens if token not in found] for name, tokens in wanted.items()}
    missing = [token for tokens in without.values() for token in tokens]
    if missing:
        raise FramesMissingError(missing, [name for name, tokens in without.items() if tokens])
