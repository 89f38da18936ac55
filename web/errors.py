"""Errors of the pages themselves."""

from pathlib import Path

from stone.errors import StoneError


class PagesNotBuiltError(StoneError):
    """What browsers load is not there."""

    code = "pages_not_built"

    def __init__(self, missing: Path) -> None:
        super().__init__(f"{missing} is not there: the pages' modules were not built; run `make install`")
