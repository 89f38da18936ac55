"""The bell of the queue `ingest`: one job per ring.

**Conventions.** Loaded by the worker's parent before it forks, so the kernels are imported once; one thread for every
library, said before any of them is loaded.
"""

import services.runtime.one_thread  # noqa: F401

# isort: split

from celery import shared_task

from services.ingest.stages import handlers, open_described, open_recording
from services.runtime.jobs.running import run_next
from services.runtime.platform import platform
from services.runtime.sample_sources import provide_samples
from services.runtime.sweep_sources import provide_sweeps

provide_sweeps(open_described)
provide_samples(open_recording)


@shared_task(name="ingest.work", ignore_result=True)
def work() -> bool:
    """Run the next job; false when there was none."""
    return run_next(platform(), "ingest", handlers(platform()))
