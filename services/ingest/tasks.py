"""The Celery task of the queue `ingest`: each wake-up runs one job.

**Conventions.** Loaded by the worker's parent before it forks, so the kernels are imported once; one thread for every
library, said before any of them is loaded.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

from celery import shared_task

from services.ingest.stages import handlers
from services.runtime.jobs.execution import run_next
from services.runtime.platform import platform


@shared_task(name="ingest.work", ignore_result=True)
def work() -> bool:
    """Run the next job; false when there was none."""
    return run_next(platform(), "ingest", handlers(platform()))
