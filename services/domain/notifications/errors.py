"""Refusals of where notifications should be sent."""

from stone.errors import StoneError


class BadWebhookUrlError(StoneError):
    """The webhook URL is not allowed."""

    code = "bad_webhook_url"

    def __init__(self, why: str) -> None:
        super().__init__(f"no webhook of this platform: {why}")


class BadEmailAddressError(StoneError):
    """Not an e-mail address."""

    code = "bad_email_address"

    def __init__(self, address: str) -> None:
        super().__init__(f"{address[:80]!r} is no e-mail address as ada@example.org is (at most 254 characters, ASCII)")


class NoEmailError(StoneError):
    """The platform sends no e-mail."""

    code = "no_email"

    def __init__(self) -> None:
        super().__init__("e-mail is not configured on this platform (SMTP)")


class EmailVerificationError(StoneError):
    """The secret of a mailed link does not verify the account's address."""

    code = "email_not_verified"

    def __init__(self) -> None:
        super().__init__("this link is not the newest one sent, or older than a day, or of another account; ask again")


class TooManyVerificationsError(StoneError):
    """Too many e-mails were sent to verify addresses of one user."""

    code = "too_many_verifications"

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} e-mails were sent today to verify an address of yours; try again tomorrow")


class NoWebhookError(StoneError):
    """The user has no webhook."""

    code = "no_webhook"

    def __init__(self) -> None:
        super().__init__("you have no webhook yet; set its URL first")
