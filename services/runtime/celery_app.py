"""The Celery application: a queue per service, prefork workers, and bells instead of payloads.

**Conventions.** A message says "there is work in this queue" and no more: the worker that hears it claims the next
job from the database (`services/runtime/jobs`). So a message lost costs a second (the sweeper rings again), a message
delivered twice finds nothing to do, and priorities and fairness are decided where they can be queried.

**The pool is prefork**, on evidence (Celery 5.7, Open3D 0.20): thread pools enforce no time limits and share a GIL with
Open3D's bindings; memory, filesystem and SQL brokers lose running work on kill −9. A parent that *used* Open3D
before forking leaves its children with one thread for ever, one that only imported it does not, so the parent imports
the kernels (children start in milliseconds) and never calls them. Each child has one thread per library: the
parallelism is over jobs. `worker_cancel_long_running_tasks_on_connection_loss` stays off: it loses jobs.
"""

import os
from typing import TYPE_CHECKING

from celery import Celery, current_app
from celery.signals import setup_logging, worker_init, worker_process_init, worker_process_shutdown
from sqlalchemy.orm import configure_mappers

from services.runtime.log_lines import speak_json
from services.runtime.parent_death import die_with
from services.runtime.settings import Settings
from services.runtime.telemetry.tracing import close_tracing, open_tracing

if TYPE_CHECKING:
    from services.runtime.jobs.presence import Presence

QUEUES = ("ingest", "labeler", "eval")


def make_app(settings: Settings) -> Celery:
    """The application for these settings; a worker says which services' tasks it loads (`processes/worker.py`)."""
    app = Celery("stone", broker=settings.broker.address)
    app.conf.update(
        task_ignore_result=True,
        task_acks_late=False,  # a bell not yet acked when Redis ends makes kombu 5.7 end the worker, and its jobs
        task_reject_on_worker_lost=False,  # attempts are counted in the database; a poisoned job must not loop here
        worker_prefetch_multiplier=1,
        worker_disable_prefetch=True,  # a bell held by a busy worker is not heard by an idle one
        worker_cancel_long_running_tasks_on_connection_loss=False,
        worker_max_tasks_per_child=200,
        worker_redirect_stdouts=False,
        worker_hijack_root_logger=False,
        task_time_limit=settings.jobs.time_limit_s + 60,  # the net; the attempt itself keeps the limit
        task_default_queue="ingest",
        task_routes={f"{name}.work": {"queue": name} for name in QUEUES},
        broker_connection_retry_on_startup=True,
        broker_transport_options={
            "visibility_timeout": settings.broker.visibility_timeout_s,
            "unacked_restore_interval": 5,  # kombu's own cadence redelivers up to 90 s late
            "unacked_restore_throttle": 1,
            "socket_connect_timeout": 2,
            "socket_timeout": 30,
        },
    )
    return app


app = make_app(Settings())
_HERE: list["Presence"] = []


@worker_process_init.connect
def _end_with_the_worker(**_: object) -> None:
    """A pool process whose worker was killed would work on, and hold its job by its heartbeats, until the job ends."""
    die_with(os.getppid())


@worker_process_init.connect
def _say_here(**_: object) -> None:
    """Imported here: the platform rings by this application."""
    from services.runtime.jobs.presence import Presence
    from services.runtime.platform import platform

    open_tracing("stone-worker")  # here: a process that forks takes no exporter with it
    queues = list(current_app.amqp.queues.consume_from)  # first: the platform's bell is an application too
    presence = Presence(platform(), queues)
    presence.start()
    _HERE.append(presence)


@worker_process_shutdown.connect
def _say_gone(**_: object) -> None:
    for presence in _HERE:
        presence.leave()
    close_tracing()


@worker_init.connect
def _know_the_rows(**_: object) -> None:
    """Once, before the fork: half-way through, a signal for the first job would leave the child without its tables."""
    configure_mappers()


@setup_logging.connect
def _speak(**_: object) -> None:
    """Celery's lines and ours in one shape, instead of a format of its own."""
    speak_json()
