"""How a worker of one service opens sweeps that another service has described.

**Conventions.** The services never import each other: ingest says here, when its tasks are loaded, how its description
is read; the labeler asks here. A worker loads the tasks of all services (`services/runtime/celery_app.py`).
"""

from collections.abc import Callable

from services.runtime.platform import Platform
from stone.errors import StoneError
from stone.sequence import SweepSource

OpenSweeps = Callable[[Platform, bytes], SweepSource]
_PROVIDED: list[OpenSweeps] = []


class NoSweepsProvidedError(StoneError):
    """This worker cannot read recordings."""

    code = "no_sweeps_provided"

    def __init__(self) -> None:
        super().__init__("nothing in this worker reads recordings; was it started without the tasks of ingest?")


def provide_sweeps(opened: OpenSweeps) -> None:
    """From now on sweeps are opened so."""
    _PROVIDED[:] = [opened]


def open_sweeps(platform: Platform, description: bytes) -> SweepSource:
    """The sweeps of a description. Raises `NoSweepsProvidedError`."""
    if not _PROVIDED:
        raise NoSweepsProvidedError
    return _PROVIDED[0](platform, description)
