"""The Celery application: one queue per service, prefork workers, messages that only wake them up.

**The pool is prefork**, on evidence (Celery 5.7, Open3D 0.20). Thread pools enforce no time limits and share a GIL with
Open3D's bindings. Memory, filesystem and SQL brokers lose running work on kill −9. If a parent has *used* Open3D before
forking, its children are limited to one thread; importing it is harmless. The parent therefore imports the kernels
(children start in milliseconds) and never calls them. Each child has one thread per library: the parallelism is over
jobs. `worker_cancel_long_running_tasks_on_connection_loss` stays off: it loses jobs.
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

# A worker's slot for a wake-up is released even if the broker did not receive the acknowledgement. A worker has as many
# slots as processes, and does not listen to the broker while all are taken. kombu 5.7 releases a slot after Redis has
# answered the acknowledgement. If Redis ends at that time, the slot is never released; and since the worker does not
# listen, it does not notice the lost connection and takes no more jobs. Releasing the slot in any case loses nothing,
# because a duplicate wake-up finds nothing to do.


class WakeUpQoS(redis.QoS):
    """The delivered but unacknowledged messages of a channel."""

    def ack(self, delivery_tag: str) -> None:
        """Acknowledge a message and release its slot. Raises what the connection raises."""
        try:
            super().ack(delivery_tag)  # type: ignore[no-untyped-call]
        finally:
            virtual.QoS.ack(self, delivery_tag)  # type: ignore[no-untyped-call]


def free_room_in_any_case() -> None:
    """Make channels of this process use `WakeUpQoS`."""
    redis.Channel.QoS = WakeUpQoS


free_room_in_any_case()
app = make_app(Settings())
_HERE: list[WorkerHeartbeat] = []


@worker_process_init.connect
def _end_with_the_worker(**_: object) -> None:
    """End with the worker: otherwise a pool process of a killed worker continues its job and its heartbeats."""
    die_with(os.getppid())


@worker_process_init.connect
def _say_here(**_: object) -> None:
    setup_tracing("stone-worker")  # in the child: a fork inherits no exporter
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
    """Prepare the pool's common state: a lease keeper, and the tables.

    A signal for the first job could otherwise leave a child with half of the tables.
    """
    configure_mappers()
    start_keeper(Settings())


@setup_logging.connect
def _speak(**_: object) -> None:
    """Log Celery's lines in the platform's format."""
    speak_json()


# Reads a wake-up with the application's time limit and ignores the message's. Anyone with write access to the broker
# can set a header `timelimit`; with it each wake-up would kill the process that works for it, and three of them the
# job.


class WakeUpRequest(Request):  # type: ignore[misc]
    """A message in a worker, without limits of its own."""

    @property
    def time_limits(self) -> tuple[None, None]:
        return None, None

    @time_limits.setter
    def time_limits(self, _said: Any) -> None:
        """Ignore the message's limits, which Celery sets."""
