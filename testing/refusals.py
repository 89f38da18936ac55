"""Expect a refusal by its code."""

import pytest

from stone_base.errors import StoneError


def refused_as(code: str, match: str | None = None) -> pytest.RaisesExc[StoneError]:
    """Expect a `StoneError` whose code is `code` and whose sentence matches `match`."""
    return pytest.raises(StoneError, match=match, check=lambda error: error.code == code)
