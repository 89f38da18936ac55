"""Why a profile of topics cannot be used.

**Conventions.** TOP-1xx is about which topics there are and what for.
"""

from stone.errors import StoneError


class BadProfileError(StoneError):
    """A topic profile names an unknown role, an impossible topic, or one topic twice."""

    code = "TOP-113"

    def __init__(self, found: str, expected: str) -> None:
        super().__init__(f"a topic profile cannot hold {found}; expected is {expected}")


class ProfileFileError(StoneError):
    """The file is not a topic profile."""

    code = "TOP-114"

    def __init__(self, name: str, fault: str) -> None:
        super().__init__(
            f"{name} is not a topic profile: {fault}; expected are `stone_profile: 1` and `topics:` by role"
        )
