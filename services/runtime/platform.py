"""The platform of a process: its settings, database and store, opened once.

**Conventions.** `platform()` is for entry points (a Celery task, the API's start, a supervisor); everything below
them is handed what it needs. It is keyed by pid, so a forked worker opens its own connections.
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
    """The outside as one value."""

    settings: Settings
    database: Database
    store: Store


_OPENED: dict[int, Platform] = {}

log = structlog.get_logger(__name__)


def open_platform(settings: Settings) -> Platform:
    """A platform of its own, which sends wake-ups to the broker of `settings`; settings' old names are warned of."""
    for name in old_names_in_use():
        log.warning("setting was renamed; the next release drops its old name", setting=name, use=RENAMED[name])
    return Platform(settings, Database(settings, wake_up_sender(settings)), open_store(settings))


def open_silent_platform(settings: Settings) -> Platform:
    """A platform that sends no wake-ups, while no worker is there: a broker that is away is not waited for."""
    return Platform(settings, Database(settings), open_store(settings))


def platform() -> Platform:
    """The platform of this process, from the environment."""
    if os.getpid() not in _OPENED:
        _OPENED[os.getpid()] = open_platform(Settings())
    return _OPENED[os.getpid()]
