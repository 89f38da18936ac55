"""The bell of the queue `labeler`: one job per ring.

**Conventions.** Loaded by the worker's parent before it forks: the kernels and Open3D are imported once and never used
there, or its children would be left with one thread that waits for ever. One thread for every library.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

import open3d  # noqa: F401  loaded here so that the children need not
from celery import shared_task

from services.labeler.stages import handlers
from services.runtime.jobs.running import run_next
from services.runtime.platform import platform


@shared_task(name="labeler.work", ignore_result=True)
def work() -> bool:
    """Run the next job; false when there was none."""
    return run_next(platform(), "labeler", handlers(platform()))
