"""Errors of sandboxed work that crashed or was interrupted."""

from stone.errors import PlatformFaultError, StoneError


class SandboxCrashedError(StoneError):
    """The input broke its process or its limits; the same bytes would do so again."""

    code = "reader_crashed"

    def __init__(self, fate: str) -> None:
        self.fate = fate
        super().__init__(f"the process that read the input {fate}; the file may be damaged or malicious")


class SandboxInterruptedError(PlatformFaultError):
    """The machine interrupted the work; the input may be sound."""

    def __init__(self, fate: str) -> None:
        self.fate = fate
        super().__init__("reader_interrupted", f"the process that read the input {fate}; the platform tries again")
