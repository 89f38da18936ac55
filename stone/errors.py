"""The root of all errors, re-exported from `stone_base/errors.py`."""

from stone_base.errors import PlatformFaultError, Refused, ShapeError, StoneError, one_line

__all__ = ["PlatformFaultError", "Refused", "ShapeError", "StoneError", "one_line"]
