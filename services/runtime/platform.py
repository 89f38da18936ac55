"""What a process holds of the outside: settings, database, store and bell, opened once per process.

**Conventions.** `platform()` is for entry points (a Celery task, the API's start, a supervisor); everything below
them is handed what it needs. It is keyed by pid, so a forked worker opens its own connections.
"""

import os
from dataclasses import dataclass

from services.runtime.bell import ring
from services.runtime.database import Database
from services.runtime.settings import Settings
from services.runtime.store import Store, open_store


@dataclass(frozen=True)
class Platform:
    """The outside as one value."""

    settings: Settings
    database: Database
    store: Store


_OPENED: dict[int, Platform] = {}


def open_platform(settings: Settings) -> Platform:
    """A platform of its own, whose bells ring in the broker of `settings`."""
    return Platform(settings, Database(settings, ring(settings)), open_store(settings))


def open_silent_platform(settings: Settings) -> Platform:
    """One that rings no bell, while no worker is there to hear it: a broker that is away is not waited for."""
    return Platform(settings, Database(settings), open_store(settings))


def platform() -> Platform:
    """The platform of this process, from the environment."""
    if os.getpid() not in _OPENED:
        _OPENED[os.getpid()] = open_platform(Settings())
    return _OPENED[os.getpid()]
