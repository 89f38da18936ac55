"""Command lines, environments and stop timeouts of the child processes.

**Conventions.** Every process reads its settings from the environment, as in a cluster; nothing is passed otherwise but
the API's listening socket. A worker has one thread per library: its parallelism is over jobs. It stands back where
processors are short: whoever waits for a page waits for a second of it, whoever waits for labels for minutes.
"""

import os
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from pydantic import SecretStr

from services.runtime.embedded.child_process import Program
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.settings import Settings

DRAIN_S = 15.0
WORKER_NICENESS = 5  # a third of the share of others
REPLIES_S = 5
ONE_THREAD = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_THREAD_LIMIT")
}


def environment_of(settings: Settings) -> dict[str, str]:
    """This process's environment with `settings` in place of whatever `STONE_*` it had."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("STONE_")}
    named: dict[str, str] = {}
    for name in type(settings).model_fields:
        named |= _named(f"STONE_{name.upper()}", getattr(settings, name))
    return {**inherited, **named, "STONE_DATA_FOLDER": str(settings.root), "PYTHONUNBUFFERED": "1"}


def api_program(settings: Settings, descriptor: int) -> Program:
    """uvicorn on a socket that is listening already."""
    argv = _python("services.runtime.embedded.api_process", str(descriptor), str(REPLIES_S))
    return Program("api", argv, environment_of(settings), settings.root, REPLIES_S + 3.0, (descriptor,))


def worker_program(settings: Settings) -> Program:
    """One Celery worker for all queues; it forks `settings.concurrency` processes."""
    argv = _python("services.runtime.processes.worker", *QUEUES)
    environment = environment_of(settings) | ONE_THREAD
    return Program("worker", argv, environment, settings.root, DRAIN_S, niceness=WORKER_NICENESS)


def sweeper_program(settings: Settings) -> Program:
    argv = _python("services.maintenance.sweeper")
    return Program("sweeper", argv, environment_of(settings), settings.root, 5.0)


def _python(module: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-P", "-m", module, *arguments)


def _named(name: str, value: Any) -> Mapping[str, str]:
    if is_dataclass(value) and not isinstance(value, type):
        parts = [_named(f"{name}__{part.name.upper()}", getattr(value, part.name)) for part in fields(value)]
        return {key: text for part in parts for key, text in part.items()}
    if isinstance(value, SecretStr):
        return {name: value.get_secret_value()}
    return {name: str(value)}
