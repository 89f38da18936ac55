"""Errors of authentication and of user accounts."""

from collections.abc import Iterable

from stone.errors import StoneError


class WeakPasswordError(StoneError):
    """A password is too short to resist guessing, or too long to be one."""

    code = "weak_password"

    def __init__(self, length: int, shortest: int, longest: int) -> None:
        super().__init__(f"the password has {length} characters; it must have {shortest} to {longest}")


class GuessablePasswordError(StoneError):
    """The password is easy to guess."""

    code = "guessable_password"

    def __init__(self, reason: str) -> None:
        super().__init__(f"the password {reason}; take several words that have nothing to do with each other")


class BadNameError(StoneError):
    """A name for a user has characters that would be mistaken for something else."""

    code = "bad_name"

    def __init__(self, name: str) -> None:
        super().__init__(f"{name[:80]!r} cannot be a name; use 1 to 64 of a-z, 0-9, '.', '_', '-', '@', '+'")


class NameTakenError(StoneError):
    """Somebody or something else has this name already."""

    code = "name_taken"

    def __init__(self, kind: str, name: str) -> None:
        super().__init__(f"there is a {kind} named {name[:80]!r} already; choose another name")


class UnknownRoleError(StoneError):
    """There is no such role."""

    code = "unknown_role"

    def __init__(self, role: str, known: Iterable[str]) -> None:
        super().__init__(f"{role[:80]!r} is no role; roles are {', '.join(known)}")


class LastAdministratorError(StoneError):
    """The last administrator cannot be removed."""

    code = "last_administrator"

    def __init__(self, name: str) -> None:
        super().__init__(f"{name!r} is the last active administrator; make another one first")


class BusyError(StoneError):
    """Too many passwords are being checked at this moment, or too many programs wait."""

    code = "busy"

    def __init__(self, most: int, what: str = "passwords are being checked at this moment") -> None:
        super().__init__(f"{most} {what}; try again in a moment")


class PasswordsOffError(StoneError):
    """Password sign-in is disabled."""

    code = "passwords_off"

    def __init__(self) -> None:
        super().__init__("passwords are switched off here (STONE_API__PASSWORDS); sign in with the provider")
