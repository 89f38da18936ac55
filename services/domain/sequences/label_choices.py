"""Allowed label settings and their bounds: the profile, and parameters by dotted name.

**Conventions.** A name is a path into the labeler's `LabelParameters` (`reference.alpha`). Only parameters that affect
quality are allowed. Parameters with unbounded cost (a cell of a millimetre) and the lattice shared by neighbouring
tiles are excluded. A whole number's bounds are integers. The labeler applies the choices; tests compare names, bounds
and defaults with the labeler. Label workers load this module, so it imports no database code.
"""

from collections.abc import Mapping
from typing import Literal, get_args

from stone.errors import Refused

LabelProfile = Literal["field", "local", "paper"]
PROFILES: tuple[LabelProfile, ...] = get_args(LabelProfile)
DEFAULT_PROFILE: LabelProfile = "field"
BOUNDS: Mapping[str, tuple[float, float]] = {
    "selection.min_range_m": (0.5, 5.0),
    "surface.min_frames": (1, 20),
    "surface.normal_neighbours": (8, 64),
    "surface.trim_m": (0.05, 1.0),
    "dynamic.every_frame": (1, 50),
    "dynamic.margin_m": (0.05, 2.0),
    "carve.every_frame": (1, 50),
    "terrain.neighbours": (8, 64),
    "terrain.roughness_floor_m2": (1e-12, 1e-2),
    "reference.alpha": (1e-4, 0.5),
    "reference.outlier_ratio": (0.0, 0.5),
    "reference.clean_mads": (0.0, 10.0),
    "footprint_band_m": (0.05, 1.0),
    "local_ground_radius_m": (0.2, 5.0),
}

DEFAULTS: Mapping[str, float] = {
    "selection.min_range_m": 1.0,
    "surface.min_frames": 1,
    "surface.normal_neighbours": 20,
    "surface.trim_m": 0.2,
    "dynamic.every_frame": 2,
    "dynamic.margin_m": 0.3,
    "carve.every_frame": 5,
    "terrain.neighbours": 20,
    "terrain.roughness_floor_m2": 1e-6,
    "reference.alpha": 0.05,
    "reference.outlier_ratio": 0.0,
    "reference.clean_mads": 3.5,
    "footprint_band_m": 0.15,
    "local_ground_radius_m": 0.5,
}
OF_PROFILE: Mapping[str, Mapping[str, float]] = {"paper": {"reference.clean_mads": 0.0}}
"""The defaults of a profile that differ from `DEFAULTS`."""

LEAVING_OUT = ("reference.outlier_ratio", "reference.clean_mads")


def default_of(profile: str, name: str) -> float:
    """Return the profile's default value of a parameter."""
    return OF_PROFILE.get(profile, {}).get(name, DEFAULTS[name])


def check_choices(profile: str, parameters: Mapping[str, object]) -> None:
    """Raise `bad_parameter` for the first choice that is unknown, of the wrong type or out of bounds."""
    if profile not in PROFILES:
        raise Refused(
            "bad_parameter",
            f"'profile' cannot be {str(profile)[:80]!r}; the profiles are {', '.join(PROFILES)}",
        )
    for name, value in parameters.items():
        if name not in BOUNDS:
            raise Refused(
                "bad_parameter",
                f"{str(name)[:80]!r} cannot be {str(value)[:80]!r}; the available parameters are {', '.join(BOUNDS)}",
            )
        _check_value(name, value)
    for name in LEAVING_OUT:
        if profile == "paper" and parameters.get(name, 0.0):
            raise Refused(
                "bad_parameter",
                f"{name!r} cannot be {str(parameters[name])[:80]!r}; profile paper cannot omit it, profiles field and "
                "local can",
            )


def _check_value(name: str, value: object) -> None:
    low, high = BOUNDS[name]
    is_whole = isinstance(low, int)
    if isinstance(value, bool) or not isinstance(value, int if is_whole else (int, float)):
        raise Refused(
            "bad_parameter",
            f"{str(name)[:80]!r} cannot be {str(value)[:80]!r}; expected a {'whole ' if is_whole else ''}number "
            f"from {low:g} to {high:g}",
        )
    if not low <= value <= high:  # also rejects NaN
        raise Refused(
            "bad_parameter",
            f"{str(name)[:80]!r} cannot be {str(value)[:80]!r}; the value must be between {low:g} and {high:g}",
        )
