"""Errors of starting the embedded platform."""

from pathlib import Path

from stone.errors import StoneError


class PortTakenError(StoneError):
    """The listening address is in use, or is not an address of this machine."""

    code = "port_taken"

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(
            f"cannot listen on {host} port {port}: {reason}; choose another address with --host and --port"
        )


class StartFailedError(StoneError):
    """A process of the platform ended, or was not ready in time; its last log line is quoted."""

    code = "start_failed"

    def __init__(self, name: str, fate: str, log: Path, last_words: str) -> None:
        quoted = f": {last_words}" if last_words else ""
        super().__init__(f"{name} {fate}{quoted}; its log is {log}")
