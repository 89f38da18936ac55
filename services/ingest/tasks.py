"""The Celery task of the queue `ingest`: each wake-up runs a job, or several short jobs.

**Conventions.** Loaded by the worker's parent before it forks, so the kernels are imported once; one thread for every
library, set before any of them is loaded.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

from celery import shared_task

from services.ingest.queue_handlers import handlers
from services.runtime.jobs.execution import run_row, takes_jobs
from services.runtime.platform import platform


@shared_task(name="ingest.work", ignore_result=True)
def work() -> int:
    """Run the next job, and the short jobs after it; return the number of attempts."""
    return run_row(platform(), "ingest", handlers(platform()), takes_jobs)
