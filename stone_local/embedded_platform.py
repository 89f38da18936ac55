"""The embedded platform run by a command: start, sign-in of the other commands, and drain at the end.

**Conventions.** The first Ctrl-C or SIGTERM drains, the second ends at once. The token of this machine is stored with
the user's credentials; it becomes the default only if there is no other server.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import NoReturn

from services.runtime.embedded.errors import PortTakenError
from services.runtime.embedded.first_start import ADMINISTRATOR, first_password_file
from services.runtime.embedded.listen_socket import listen
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.settings import Settings
from stone_client.credentials import is_local, read_credentials, remember
from stone_client.streams import echo_notice


@dataclass(frozen=True)
class Address:
    """The host and port of the API; None: from the environment."""

    host: str | None = None
    port: int | None = None


@contextmanager
def hangups_interrupt() -> Iterator[None]:
    """Treat SIGTERM and the end of the terminal as Ctrl-C. Must be entered before other signal handlers."""
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def served(settings: Settings, *, is_awaited: bool = True) -> Iterator[RunningPlatform]:
    """Yield the running platform. Raises what `running_platform` raises."""
    with hangups_interrupt(), running_platform(settings, echo_notice, is_awaited=is_awaited) as running:
        _remember(running)
        yield running


def settings_for(data: Path | None, address: Address, workers: int | None) -> Settings:
    """Return the environment's settings, overridden by the command line."""
    settings = Settings()
    host = settings.api.host if address.host is None else address.host
    port = settings.api.port if address.port is None else address.port
    return settings.model_copy(
        update={
            "data_folder": data or settings.data_folder,
            "workers": workers or settings.workers,
            "api": replace(settings.api, host=host, port=port),
        }
    )


def demo_settings(data: Path | None, workers: int | None) -> Settings:
    """Return the settings of a demo platform: if its usual port is taken, any free port."""
    settings = settings_for(data, Address(), workers)
    try:
        listen(settings.api).close()
    except PortTakenError:
        return settings_for(data, Address(port=0), workers)
    return settings


def password_line(settings: Settings) -> str:
    """Return where the administrator's initial password is; empty if no file contains it."""
    file = first_password_file(settings)
    if file is None:
        return ""
    return f"Administrator: {ADMINISTRATOR}; the first password is in {file}, unless it was changed"


def wait_for_ctrl_c() -> None:
    """Wait for Ctrl-C or SIGTERM."""
    try:
        while True:
            time.sleep(3600.0)
    except KeyboardInterrupt:
        return


def _remember(running: RunningPlatform) -> None:
    default = read_credentials().default
    remember(running.url, running.keys.token, as_default=not default or is_local(default))


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt
