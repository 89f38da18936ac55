"""Errors of the tus protocol, raised before any byte of the body is read."""

from api.errors import ApiError

VERSION = "1.0.0"


class TusVersionError(ApiError):
    """Tus-Resumable is missing or not 1.0.0."""

    code = "tus_version"

    def __init__(self, given: str) -> None:
        super().__init__(f"Tus-Resumable is {given[:40]!r}; this server supports {VERSION} only")

    @property
    def headers(self) -> dict[str, str]:
        return {"Tus-Version": VERSION}


class TusHeaderError(ApiError):
    """A header of the tus protocol is missing or cannot be read."""

    code = "bad_tus_header"

    def __init__(self, name: str, given: str, expected: str) -> None:
        super().__init__(f"{name} is {given[:80]!r}; expected {expected}")


class LengthDeferredError(ApiError):
    """Upload-Defer-Length is not supported; the length must be known at creation."""

    code = "length_deferred"

    def __init__(self) -> None:
        super().__init__("Upload-Defer-Length is not supported: send Upload-Length with the creation")


class ExtensionError(ApiError):
    """The client asks for a part of tus that this server does not have."""

    code = "tus_extension"

    def __init__(self, header: str) -> None:
        super().__init__(f"{header} belongs to an extension that this server does not have; see OPTIONS")


class UnsupportedMediaTypeError(ApiError):
    """The body is not of the type that this route reads."""

    code = "unsupported_media_type"

    def __init__(self, given: str, expected: str) -> None:
        super().__init__(f"Content-Type is {given[:80]!r}; expected {expected}")


class ReceiveTimeoutError(ApiError):
    """The client sent nothing for too long; what was written before counts."""

    code = "receive_timeout"

    def __init__(self, idle_s: float) -> None:
        super().__init__(f"nothing came for {idle_s:g} s; ask for the offset and resume from there")

    @property
    def headers(self) -> dict[str, str]:
        return {"Connection": "close"}


class FormError(ApiError):
    """The form cannot be read, or does not hold what is expected."""

    code = "bad_form"

    def __init__(self, why: str) -> None:
        super().__init__(f"the form is not understood: {why} (curl -F file=@NAME -F purpose=recording -F target_id=ID)")
