"""The words for the surroundings of a sequence: environments, illuminations, regions.

**Conventions.** These words are defined only here. '' means unspecified. An environment is one of the paper's four,
another offered word, or any plain word. Each illumination is day or night: cameras see daylight from sunrise to sunset,
and also at dawn and dusk. A region is a free plain name.
"""

import re
from collections.abc import Mapping

from stone.errors import Refused

ENVIRONMENTS = ("farmland", "mountain", "lake", "construction")
"""The paper's environments."""
OFFERED = (*ENVIRONMENTS, "beach", "desert", "forest", "meadow", "mine", "orchard", "quarry", "road", "snow", "urban")
ENVIRONMENT = re.compile(r"[a-z][a-z0-9-]{0,31}")
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


def checked_environment(word: str) -> str:
    """Return the word. Raises `unknown_environment`."""
    if word != UNSAID and not ENVIRONMENT.fullmatch(word):
        raise Refused(
            "unknown_environment",
            f"{word[:64]!r} is not a valid environment; use one of {', '.join(OFFERED)}, another word of at "
            "most 32 lower-case letters, digits and dashes that starts with a letter, or '' for unspecified",
        )
    return word


def checked_illumination(word: str) -> str:
    """Return the word. Raises `unknown_illumination`."""
    if word not in (UNSAID, *ILLUMINATIONS):
        raise Refused(
            "unknown_illumination",
            f"{word[:64]!r} is no illumination; use {', '.join(ILLUMINATIONS)} or ''",
        )
    return word


def checked_region(name: str) -> str:
    """Return the name. Raises `bad_region`."""
    if name != UNSAID and not REGION.fullmatch(name):
        raise Refused(
            "bad_region",
            f"{name[:80]!r} is not a valid region. Use 1 to 64 letters, digits, dots, dashes and underscores, "
            "starting with a letter or digit, or '' for unspecified (a space between words? use a dash)",
        )
    return name
