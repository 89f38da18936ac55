"""The Celery application of wake-up messages: a queue per service, no payloads.

**Conventions.** A message says "there is work in this queue" and no more: the worker that hears it claims the next
job from the database (`services/runtime/jobs`). So a message lost costs a second (the sweeper rings again), a message
delivered twice finds nothing to do, and priorities and fairness are decided where they can be queried. What a worker's
process does besides is in `services/runtime/jobs/celery_app.py`.

Whoever can write to the broker can wake workers up, and no more: remote control (by which one shuts workers down, asks
them what they hold, or changes their limits) and events are off, and what a message says of itself is not read.
"""

from celery import Celery, Task

from services.runtime.settings import Settings

QUEUES = ("ingest", "labeler", "eval")


class WakeUpTask(Task):  # type: ignore[misc]
    """A task whose messages set nothing: neither its limits nor anything else."""

    Request = "services.runtime.jobs.celery_app:WakeUpRequest"


def make_app(settings: Settings) -> Celery:
    """The application for these settings; a worker says which services' tasks it loads (`processes/worker.py`)."""
    app = Celery("stone", broker=settings.broker.address, task_cls=WakeUpTask)
    app.conf.update(
        worker_enable_remote_control=False,
        worker_send_task_events=False,
        task_send_sent_event=False,
        task_ignore_result=True,
        task_acks_late=False,  # a wake-up not yet acked when Redis ends makes kombu 5.7 end the worker, and its jobs
        task_reject_on_worker_lost=False,  # attempts are counted in the database; a poisoned job must not loop here
        worker_prefetch_multiplier=1,
        worker_disable_prefetch=True,  # a wake-up kept by a busy worker reaches no idle one
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
