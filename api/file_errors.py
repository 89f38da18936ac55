"""Errors of file downloads and file uploads."""

from collections.abc import Mapping
from typing import Any

from api.errors import ApiError
from stone.errors import StoneError


class RangeError(ApiError):
    """The range begins behind the end of the file."""

    code = "range_not_satisfiable"

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        super().__init__(f"the file has {size_bytes} bytes and the range begins behind them")

    @property
    def headers(self) -> dict[str, str]:
        return {"Content-Range": f"bytes */{self.size_bytes}", "Accept-Ranges": "bytes"}


class CalibrationRefusedError(ApiError):
    """The calibration is refused; `errors` has the code of the check."""

    code = "calibration_refused"

    def __init__(self, filename: str, reason: StoneError) -> None:
        self._filename, self._reason = filename, reason
        super().__init__(str(reason))

    @property
    def findings(self) -> tuple[Mapping[str, Any], ...]:
        return ({"code": self._reason.code, "where": "file", "file": self._filename, "expected": str(self._reason)},)
