"""The root of every error, by the name that the science and the platform know it by (`stone_base/errors.py`)."""

from stone_base.errors import PlatformFaultError, Refused, ShapeError, StoneError, one_line

__all__ = ["PlatformFaultError", "Refused", "ShapeError", "StoneError", "one_line"]
