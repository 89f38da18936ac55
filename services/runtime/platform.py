"""The platform of a process: its settings, database and store, opened once.

**Conventions.** `platform()` is for entry points (a Celery task, the API's start, a supervisor); other code receives it
as an argument. It is keyed by pid, so a forked worker opens its own connections.
"""

import os
from dataclasses import dataclass

import structlog

from services.runtime.database.transactions import Database
from services.runtime.jobs.wakeup import wake_up_sender
from services.runtime.settings import Settings, old_names_in_use
from services.runtime.settings_checks import RENAMED
from services.runtime.store.factory import open_store
from services.runtime.store.protocol import Store


@dataclass(frozen=True)
class Platform:
    """Settings, database, store and broker as one value."""

    settings: Settings
    database: Database
    store: Store


_OPENED: dict[int, Platform] = {}

log = structlog.get_logger(__name__)


def open_platform(settings: Settings) -> Platform:
    """Open a platform that sends wake-ups to the broker of `settings`; log old setting names that are in use."""
    for name in old_names_in_use():
        log.warning("setting was renamed; the next release drops its old name", setting=name, use=RENAMED[name])
    return Platform(settings, Database(settings, wake_up_sender(settings)), open_store(settings))


def open_silent_platform(settings: Settings) -> Platform:
    """Open a platform without wake-ups, for use while no worker runs: it does not wait for an unavailable broker."""
    return Platform(settings, Database(settings), open_store(settings))


def platform() -> Platform:
    """Return the platform of this process, from the environment."""
    if os.getpid() not in _OPENED:
        _OPENED[os.getpid()] = open_platform(Settings())
    return _OPENED[os.getpid()]
