"""A Celery worker with jobs made for killing: `celery -A tests.services.runtime.jobs.worker_app worker -Q ingest`."""

import time
from pathlib import Path

import services.runtime.processes.worker  # noqa: F401  # it drains as a deployed one does
from services.runtime.jobs.broker_app import make_app
from services.runtime.jobs.execution import run_row, takes_jobs
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.platform import platform
from services.runtime.settings import Settings

app = make_app(Settings())
app.conf.include = []


def note(attempt: Attempt) -> Outcome:
    """Leave one line in the job's file, take a while, say so."""
    with Path(str(attempt.arguments["file"])).open("a") as file:
        file.write("started\n")
    steps = int(attempt.arguments.get("steps", 1))
    for step in range(steps):
        attempt.progress("steps", step, steps)
        time.sleep(0.05)
    return Outcome({"steps": steps})


def freeze(attempt: Attempt) -> Outcome:
    """Hear nothing, as inside a library."""
    Path(str(attempt.arguments["file"])).write_text("started\n")
    time.sleep(600)
    return Outcome()


@app.task(name="ingest.work")  # type: ignore[untyped-decorator]
def work() -> None:
    run_row(platform(), "ingest", {"ingest.note": note, "ingest.freeze": freeze}, takes_jobs)
