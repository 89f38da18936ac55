"""Errors of publishing and reading dataset versions."""

from collections.abc import Sequence

from stone.errors import StoneError


class NoSplitsError(StoneError):
    """No sequence is in the splits yet."""

    code = "no_splits"

    def __init__(self) -> None:
        super().__init__("no sequence is in train, val or test; save the splits first (PUT /splits)")


class BrokenSplitsError(StoneError):
    """The splits were good when they were put, and are not any more."""

    code = "splits_broken"

    def __init__(self, sentences: Sequence[str]) -> None:
        more = f"; and {len(sentences) - 3} more" if len(sentences) > 3 else ""
        super().__init__(f"the splits break {len(sentences)} rule(s) by now: {'; '.join(sentences[:3])}{more}")


class SplitsChangedError(StoneError):
    """Somebody changed the splits while the version was prepared."""

    code = "splits_changed"

    def __init__(self, before: int, now: int) -> None:
        super().__init__(f"the splits went from revision {before} to {now} meanwhile; review them and publish again")


class HiddenPartError(StoneError):
    """The labels of test cannot be downloaded."""

    code = "hidden_part"

    def __init__(self, part: str) -> None:
        super().__init__(f"the files of {part!r} cannot be downloaded; train and val can")
