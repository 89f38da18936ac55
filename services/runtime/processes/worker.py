"""A worker's process: `python -m services.runtime.processes.worker QUEUE…`.

**Conventions.** It loads only the services of its queues and their imports, so an image contains only the code of its
role. On SIGTERM it takes no more jobs. Running jobs have `jobs.drain_s`; then their processes are killed and the jobs
are queued again without losing an attempt. A second SIGTERM changes nothing.
"""

import services.runtime.one_thread
import services.runtime.processes.seldom_collected
import services.runtime.processes.sound_settings  # noqa: F401

# isort: split

import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread

import structlog
from billiard.process import active_children  # type: ignore[import-untyped]
from celery.signals import worker_shutting_down

from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.celery_app import app
from services.runtime.jobs.claims import worker_name
from services.runtime.jobs.execution import stop_claiming
from services.runtime.jobs.lease_sweep import WORKER_STOPPED, give_back_of
from services.runtime.platform import platform
from services.runtime.processes.private_files import keep_private
from services.runtime.sandbox.fork_client import use_fork_server
from services.runtime.settings import Settings
from services.runtime.telemetry.descriptors import raise_descriptor_limit
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import Refused

# Modules loaded for the sandboxed children of a service: compiled kernels, and the modules of their work.
FORKED_FROM = {
    "ingest": (
        "services.ingest.kernel_warmup:warm",
        "services.ingest.sandboxed_inspection",
        "services.ingest.sandboxed_synchronisation",
        "services.ingest.sandboxed_synchronisation",
    ),
    "labeler": (
        "services.labeler.imports.kernel_warmup:warm_imports",
        "services.labeler.sandboxed_run",
        "services.labeler.exports.sandboxed_export",
        "services.labeler.exports.playback",
        "services.labeler.imports.indexing",
        "services.labeler.imports.scene_import",
        "pyarrow.compute",  # used when tables are written
    ),
    "eval": ("services.eval.kernel_warmup:warm", "services.eval.examination", "services.eval.sandboxed_truth"),
}

log = structlog.get_logger(__name__)


def services_of(queues: Sequence[str]) -> tuple[str, ...]:
    """Return the services that a worker of these queues loads."""
    return tuple(name for name in QUEUES if name in queues)


def arguments(queues: Sequence[str], concurrency: int) -> list[str]:
    """Return Celery's command line. Raises `unknown_queue`."""
    if not queues or not set(queues) <= set(QUEUES):
        raise Refused(
            "unknown_queue",
            f"no worker for the queues {', '.join(queues) or '(none)'}: name at least one of {', '.join(QUEUES)}",
        )
    loaded = ",".join(f"services.{name}.tasks" for name in services_of(queues))
    return [
        *("worker", "--pool", "prefork", "--loglevel", "INFO", "--concurrency", str(concurrency)),
        *("--queues", ",".join(queues), "--include", loaded),
        *("--without-gossip", "--without-mingle", "--without-heartbeat"),
    ]


@worker_shutting_down.connect
def _drain(**_: object) -> None:
    """Start the drain in a thread, because this is called within a signal handler."""
    stop_claiming()
    Thread(target=_end_after, args=(Settings().jobs.drain_s,), name="drain", daemon=True).start()


def _end_after(drain_s: float) -> None:
    time.sleep(drain_s)
    pids = [child.pid for child in active_children()]
    host = worker_name().rpartition(":")[0]
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    try:
        given_back = give_back_of(platform(), [f"{host}:{pid}" for pid in pids], WORKER_STOPPED)
        log.warning("stopped before its jobs were done", drain_s=drain_s, given_back=given_back)
    finally:
        os._exit(0)


def main() -> None:
    from services.runtime.processes.startup import await_schema  # only this process needs Alembic

    keep_private()
    speak_json()
    raise_descriptor_limit()
    if "TMPDIR" in os.environ:  # the volume may be new and empty; without the folder, temporary files use memory
        Path(os.environ["TMPDIR"]).mkdir(parents=True, exist_ok=True)
    settings, queues = Settings(), sys.argv[1:]
    argv = arguments(queues, settings.concurrency)
    server = use_fork_server([loaded for name in services_of(queues) for loaded in FORKED_FROM[name]])
    server.ensure_running()  # before the fork of the pool, whose processes share it
    await_schema(settings)
    app.worker_main(argv)


if __name__ == "__main__":
    main()
