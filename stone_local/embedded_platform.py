"""The embedded platform run by a command: started, announced, known to the other commands, drained at the end.

**Conventions.** The first Ctrl-C or SIGTERM drains, the second ends at once. The token of this machine is kept with
this user's credentials; it becomes the default only where no server elsewhere is.
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
    """The host and port the API listens on; None: as the environment says."""

    host: str | None = None
    port: int | None = None


@contextmanager
def hangups_interrupt() -> Iterator[None]:
    """SIGTERM, and the end of the terminal, are Ctrl-C meanwhile. Entered before whatever else looks at signals."""
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
    """The environment's settings with what the command line says in their place."""
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
    """The settings of a platform whose port matters little: any where the usual one is taken."""
    settings = settings_for(data, Address(), workers)
    try:
        listen(settings.api).close()
    except PortTakenError:
        return settings_for(data, Address(port=0), workers)
    return settings


def password_line(settings: Settings) -> str:
    """Where the administrator's first password is; empty where no file holds one."""
    file = first_password_file(settings)
    if file is None:
        return ""
    return f"Administrator: {ADMINISTRATOR}; the initial password is in {file}, unless it was changed"


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
