"""Why a profile of topics cannot be used.

**Conventions.** TOP-1xx is about which topics there are and what for.
"""

from stone.errors import StoneError


class BadProfileError(StoneError):
    """A profile names a part there is none, a topic that cannot be, or one topic twice."""

    code = "TOP-113"

    def __init__(self, found: str, expected: str) -> None:
        super().__init__(f"a profile of topics cannot hold {found}; it holds {expected}")


class ProfileFileError(StoneError):
    """A file is no profile of topics."""

    code = "TOP-114"

    def __init__(self, name: str, fault: str) -> None:
        super().__init__(f"{name} is no profile of topics: {fault}; it reads `stone_profile: 1` and `topics:` by part")
