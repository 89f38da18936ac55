"""The Celery task of the queue `eval`: each wake-up runs one job.

**Conventions.** Loaded by the worker's parent before it forks: the kernels are imported once, for all children. One
thread for every library.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

from celery import shared_task

from services.eval.stages import handlers
from services.runtime.jobs.execution import run_next
from services.runtime.platform import platform


@shared_task(name="eval.work", ignore_result=True)
def work() -> bool:
    """Run the next job; false when there was none."""
    return run_next(platform(), "eval", handlers(platform()))
