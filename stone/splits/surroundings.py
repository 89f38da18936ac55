"""The words for where and when a sequence was driven: environments, illuminations, regions.

**Conventions.** The words are here and nowhere else. '' means that nothing was said. Each illumination is day or night:
between sunrise and sunset, and in the light of dawn and dusk, cameras see by daylight. A region is a free plain name.
"""

import re
from collections.abc import Mapping

from stone.errors import StoneError

ENVIRONMENTS = ("farmland", "mountain", "lake", "construction")
DAYLIGHT: Mapping[str, str] = {
    "day": "day",
    "sunny": "day",
    "overcast": "day",
    "dawn": "day",
    "dusk": "day",
    "night": "night",
    "moonlit": "night",
    "floodlit": "night",
}
ILLUMINATIONS = tuple(DAYLIGHT)
HALVES = ("day", "night")
REGION = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
UNSAID = ""


class UnknownEnvironmentError(StoneError):
    """A sequence is said to be of an environment that is not one of the dataset's."""

    code = "unknown_environment"

    def __init__(self, word: str) -> None:
        super().__init__(f"{word[:64]!r} is no environment; it is one of {', '.join(ENVIRONMENTS)}, or ''")


class UnknownIlluminationError(StoneError):
    """A sequence is said to be lit in a way that is neither day nor night."""

    code = "unknown_illumination"

    def __init__(self, word: str) -> None:
        super().__init__(f"{word[:64]!r} is no illumination; it is one of {', '.join(ILLUMINATIONS)}, or ''")


class BadRegionError(StoneError):
    """A region becomes a key of files and figures, so it must be a plain name."""

    code = "bad_region"

    def __init__(self, name: str) -> None:
        super().__init__(
            f"{name[:80]!r} cannot name a region: 1 to 64 letters, digits, dots, dashes and underscores, beginning "
            "with a letter or digit; or '' where it is unspecified (a blank between words? use a dash)"
        )


def checked_environment(word: str) -> str:
    """The word. Raises `UnknownEnvironmentError`."""
    if word not in (UNSAID, *ENVIRONMENTS):
        raise UnknownEnvironmentError(word)
    return word


def checked_illumination(word: str) -> str:
    """The word. Raises `UnknownIlluminationError`."""
    if word not in (UNSAID, *ILLUMINATIONS):
        raise UnknownIlluminationError(word)
    return word


def checked_region(name: str) -> str:
    """The name. Raises `BadRegionError`."""
    if name != UNSAID and not REGION.fullmatch(name):
        raise BadRegionError(name)
    return name
