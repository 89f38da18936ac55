"""The Celery application: one queue per service, prefork workers, messages that only wake them up.

**The pool is prefork**, on evidence (Celery 5.7, Open3D 0.20): thread pools enforce no time limits and share a GIL with
Open3D's bindings; memory, filesystem and SQL brokers lose running work on kill −9. A parent that *used* Open3D
before forking leaves its children with one thread for ever, one that only imported it does not, so the parent imports
the kernels (children start in milliseconds) and never calls them. Each child has one thread per library: the
parallelism is over jobs. `worker_cancel_long_running_tasks_on_connection_loss` stays off: it loses jobs.
"""

import os
from typing import Any

from celery import current_app
from celery.signals import setup_logging, worker_init, worker_process_init, worker_process_shutdown
from celery.worker.request import Request
from kombu.transport import redis, virtual
from sqlalchemy.orm import configure_mappers

from services.runtime.jobs.broker_app import make_app
from services.runtime.jobs.lease_keeper import start_keeper
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.platform import platform
from services.runtime.processes.parent_death import die_with
from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from services.runtime.telemetry.tracing import close_tracing, setup_tracing

# A worker's room for a further wake-up is free again whether or not the broker heard that one was taken.
#
# **Conventions.** A worker has room for as many wake-ups as it has processes, and does not listen to the broker while
# it has none left. kombu 5.7 frees the room of a message once Redis has answered to its acknowledgement. If Redis ends
# in that moment, the room is never free again; the worker, not listening, does not learn that the connection is gone
# either, and takes no job any more. A wake-up that is delivered twice finds nothing to do, so nothing is lost by
# freeing its room in any case.


class WakeUpQoS(redis.QoS):
    """What a channel holds that was delivered and not acknowledged yet."""

    def ack(self, delivery_tag: str) -> None:
        """Raises what the connection raises."""
        try:
            super().ack(delivery_tag)  # type: ignore[no-untyped-call]
        finally:
            virtual.QoS.ack(self, delivery_tag)  # type: ignore[no-untyped-call]


def free_room_in_any_case() -> None:
    """Have channels of this process hold wake-ups so."""
    redis.Channel.QoS = WakeUpQoS


free_room_in_any_case()
app = make_app(Settings())
_HERE: list[WorkerHeartbeat] = []


@worker_process_init.connect
def _end_with_the_worker(**_: object) -> None:
    """A pool process whose worker was killed would work on, and hold its job by its heartbeats, until the job ends."""
    die_with(os.getppid())


@worker_process_init.connect
def _say_here(**_: object) -> None:
    setup_tracing("stone-worker")  # here: a process that forks takes no exporter with it
    queues = list(current_app.amqp.queues.consume_from)  # first: the platform's sender is an application too
    presence = WorkerHeartbeat(platform(), queues)
    presence.start()
    _HERE.append(presence)


@worker_process_shutdown.connect
def _say_gone(**_: object) -> None:
    for presence in _HERE:
        presence.leave()
    close_tracing()


@worker_init.connect
def _prepare_pool(**_: object) -> None:
    """What all processes of the pool find: the tables, of which a signal for the first job might leave a child half,
    and a lease keeper."""
    configure_mappers()
    start_keeper(Settings())


@setup_logging.connect
def _speak(**_: object) -> None:
    """Celery's lines and ours in one shape, instead of a format of its own."""
    speak_json()


# How a worker reads a wake-up: the time limit is the application's, whatever the message says.
#
# **Conventions.** A header `timelimit` is anybody's who can write to the broker; with it each wake-up would kill the
# process that works for it, and with three of them the job.


class WakeUpRequest(Request):  # type: ignore[misc]
    """A message as a worker holds it, without limits of its own."""

    @property
    def time_limits(self) -> tuple[None, None]:
        return None, None

    @time_limits.setter
    def time_limits(self, _said: Any) -> None:
        """Celery sets what the message says; it is not kept."""
