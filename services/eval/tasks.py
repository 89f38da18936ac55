"""The bell of the queue `eval`: one job per ring. No kind of job is made for it yet.

Submissions reach the platform with the benchmark's routes; until then validation and scoring run by the command
(`services/eval/pipeline.py`). A job of an unknown kind fails with `unknown_kind`.
"""

from celery import shared_task

from services.runtime.jobs.running import run_next
from services.runtime.jobs.specs import Handlers
from services.runtime.platform import platform

HANDLERS: Handlers = {}


@shared_task(name="eval.work", ignore_result=True)
def work() -> bool:
    """Run the next job; false when there was none."""
    return run_next(platform(), "eval", HANDLERS)
