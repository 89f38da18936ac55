"""The Celery task of the queue `eval`: each wake-up runs a job, or several short jobs.

**Conventions.** Loaded by the worker's parent before it forks: the kernels are imported once, for all children. One
thread for every library.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

from celery import shared_task

from services.eval.queue_handlers import handlers
from services.runtime.jobs.execution import run_row, takes_jobs
from services.runtime.platform import platform


@shared_task(name="eval.work", ignore_result=True)
def work() -> int:
    """Run the next job, and the short jobs after it; return the number of attempts."""
    return run_row(platform(), "eval", handlers(platform()), takes_jobs)
