"""The Celery application of wake-up messages: a queue per service, no payloads.

**Conventions.** A message only means "there is work in this queue": the worker that receives it claims the next job
from the database (`services/runtime/jobs`). A lost message therefore costs a second (the sweeper sends another), a
duplicate finds nothing to do, and priorities and fairness are decided in the database. Other functions of a worker's
process are in `services/runtime/jobs/celery_app.py`.

Write access to the broker only allows waking workers. Remote control (shutting workers down, inspecting their jobs,
changing their limits) and events are off, and message headers are ignored.
"""

from celery import Celery, Task

from services.runtime.settings import Settings

QUEUES = ("ingest", "labeler", "eval")


class WakeUpTask(Task):  # type: ignore[misc]
    """A task whose messages cannot set limits or other options."""

    Request = "services.runtime.jobs.celery_app:WakeUpRequest"


def make_app(settings: Settings) -> Celery:
    """Return the application for these settings; a worker selects the services' tasks (`processes/worker.py`)."""
    app = Celery("stone", broker=settings.broker.address, task_cls=WakeUpTask)
    app.conf.update(
        worker_enable_remote_control=False,
        worker_send_task_events=False,
        task_send_sent_event=False,
        task_ignore_result=True,
        task_acks_late=False,  # a wake-up not yet acked when Redis ends makes kombu 5.7 end the worker, and its jobs
        task_reject_on_worker_lost=False,  # the database counts attempts; a poisoned job must not loop here
        worker_prefetch_multiplier=1,
        worker_disable_prefetch=True,  # a wake-up prefetched by a busy worker reaches no idle worker
        worker_cancel_long_running_tasks_on_connection_loss=False,
        worker_max_tasks_per_child=200,
        worker_redirect_stdouts=False,
        worker_hijack_root_logger=False,
        task_time_limit=settings.jobs.time_limit_s + 60,  # a safety net; the attempt itself enforces the limit
        task_default_queue="ingest",
        task_routes={f"{name}.work": {"queue": name} for name in QUEUES},
        broker_connection_retry_on_startup=True,
        broker_transport_options={
            "visibility_timeout": settings.broker.visibility_timeout_s,
            "unacked_restore_interval": 5,  # kombu's default redelivers up to 90 s late
            "unacked_restore_throttle": 1,
            "socket_connect_timeout": 2,
            "socket_timeout": 30,
        },
    )
    return app
