"""Why splits are refused: an error for each rule that is broken."""

from collections.abc import Mapping
from typing import Any

from api.errors import ApiError
from stone.splits.splits import RuleFinding

NAMED = 8


class SplitRefusedError(ApiError):
    """The splits break a rule that the data allow."""

    code = "split_refused"

    def __init__(self, errors: tuple[RuleFinding, ...], names: Mapping[str, str]) -> None:
        super().__init__(f"{len(errors)} rule(s) are broken; see errors, or have splits proposed (/splits/proposal)")
        self._errors, self._names = errors, names

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return tuple(
            {"code": error.code, "where": self._where(error), "expected": error.message} for error in self._errors
        )

    def _where(self, error: RuleFinding) -> str:
        named = [self._names.get(one, one) for one in error.sequences]
        more = f" and {len(named) - NAMED} more" if len(named) > NAMED else ""
        return ", ".join(named[:NAMED]) + more
