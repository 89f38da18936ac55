"""Real workers on a real Redis, killed and frozen: the database knows better than the queue.

Catches alone a job that a real worker loses or doubles when it is killed, frozen or told to stop.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest
from celery import Celery
from redis import Redis
from sqlalchemy import select

from services.runtime.database.transactions import Database
from services.runtime.jobs.broker_app import make_app
from services.runtime.jobs.control import cancel, terminate
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.jobs.wakeup import wake_up_counter, wake_up_sender
from services.runtime.orm import JobAttempt, Worker
from services.runtime.platform import Platform
from services.runtime.settings import BrokerSettings, Settings
from testing.process_states import is_running
from testing.stone_serve import PATIENCE_S, until
from tests.services.runtime.jobs.steps import a_job, act, an_owner, job

pytestmark = pytest.mark.whole

Start = Callable[[], "subprocess.Popen[bytes]"]


def environment(settings: Settings) -> dict[str, str]:
    jobs = {f"STONE_JOBS__{name.upper()}": str(value) for name, value in vars(settings.jobs).items()}
    places = {
        "STONE_DATA_FOLDER": str(settings.data_folder),
        "STONE_DATABASE__URL": settings.database_url,
        "STONE_BROKER__URL": settings.broker.url,
    }
    return {**os.environ, **jobs, **places}


@pytest.fixture
def loud(platform: Platform, redis_url: str) -> Iterator[Platform]:
    """The platform with a real broker, and a sweeper that sweeps."""
    Redis.from_url(redis_url).flushdb()
    jobs = replace(platform.settings.jobs, lease_s=3.0, heartbeat_s=0.2, progress_s=0.1)
    settings = platform.settings.model_copy(update={"broker": BrokerSettings(redis_url), "jobs": jobs})
    ringing = Platform(settings, Database(settings, wake_up_sender(settings)), platform.store)
    with swept(ringing):
        yield ringing
    ringing.database.close()


@contextmanager
def swept(platform: Platform) -> Iterator[None]:
    sweeper, leaving = Sweeper(platform, wake_up_counter(platform.settings), wake_up_sender(platform.settings)), Event()

    def sweep() -> None:
        while not leaving.wait(0.2):
            sweeper.sweep()

    thread = Thread(target=sweep)
    thread.start()
    yield
    leaving.set()
    thread.join()


@pytest.fixture
def start(loud: Platform, tmp_path: Path) -> Iterator[Start]:
    """Starts workers of two processes each, every one in a process group of its own."""
    started: list[subprocess.Popen[bytes]] = []

    def start_one() -> "subprocess.Popen[bytes]":
        name = f"w{len(started)}-{tmp_path.name}"
        options = ["-A", "tests.services.runtime.jobs.worker_app", "worker", "-Q", "ingest", "-c", "2", "-n", name]
        quiet = ["--without-gossip", "--without-mingle", "-l", "WARNING"]
        with (tmp_path / "worker.log").open("ab") as log:
            worker = subprocess.Popen(
                [sys.executable, "-m", "celery", *options, *quiet],
                env=environment(loud.settings), stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        started.append(worker)
        return worker

    yield start_one
    for worker in started:
        kill(worker)


def kill(worker: "subprocess.Popen[bytes]") -> None:
    """kill −9 the worker and its children."""
    with suppress(ProcessLookupError):
        os.killpg(worker.pid, signal.SIGKILL)
    worker.wait()


def test_who_writes_to_the_broker_neither_ends_nor_asks_workers_nor_limits_their_jobs(
    loud: Platform, platform: Platform, start: Start, tmp_path: Path
) -> None:
    """A stranger with Redis asks, shuts down, and sends wake-ups that say to kill whoever works for them."""
    stranger = Celery(broker=loud.settings.broker.address)
    owner, worker = loud_owner(loud), start()
    first = a_job(loud, owner, "ingest.note", file=str(tmp_path / "first"))
    until(lambda: job(loud, first).state == "succeeded")
    assert stranger.control.inspect(timeout=2.0).ping() is None
    limited = a_job(platform, owner, "ingest.note", file=str(tmp_path / "second"), steps=40)
    for _ in range(3):
        stranger.send_task("ingest.work", queue="ingest", time_limit=0.2, ignore_result=True)
    until(lambda: job(loud, limited).state in ("succeeded", "failed"))
    assert (job(loud, limited).state, job(loud, limited).attempt) == ("succeeded", 1)
    stranger.control.broadcast("shutdown")
    last = a_job(loud, owner, "ingest.note", file=str(tmp_path / "third"), steps=40)
    until(lambda: job(loud, last).state == "succeeded" or worker.poll() is not None)
    assert worker.poll() is None


def test_messages_of_another_release_are_dropped_once_and_work_goes_on(
    loud: Platform, start: Start, tmp_path: Path
) -> None:
    sender = make_app(loud.settings)
    for _ in range(3):
        sender.send_task("services.ingest.tasks.work", args=("an id",), queue="ingest", ignore_result=True)
    job_id = a_job(loud, loud_owner(loud), "ingest.note", file=str(tmp_path / "noted"))
    worker = start()
    until(lambda: job(loud, job_id).state == "succeeded")
    until(lambda: wake_up_counter(loud.settings)("ingest") == 0)
    assert worker.poll() is None


def test_a_worker_killed_in_the_middle_loses_nothing_and_doubles_nothing(
    loud: Platform, start: Start, tmp_path: Path
) -> None:
    jobs = [a_job(loud, loud_owner(loud), "ingest.note", file=str(tmp_path / str(n)), steps=10) for n in range(6)]
    first = start()
    until(lambda: any(tmp_path.glob("[0-9]")))
    kill(first)
    start()
    until(lambda: all(job(loud, one).state == "succeeded" for one in jobs))
    starts = sum(len((tmp_path / str(n)).read_text().splitlines()) for n in range(6))
    attempts = sum(job(loud, one).attempt for one in jobs)
    assert starts <= attempts <= 8, "two were under way, perhaps not yet started, and ran again"
    with loud.database.reading() as session:
        ended_well = session.scalars(select(JobAttempt.job_id).where(JobAttempt.outcome == "succeeded")).all()
    assert sorted(ended_well) == sorted(jobs), "each succeeded once"


def test_a_worker_takes_the_next_job_after_one_that_killed_its_process_was_stopped_or_froze(
    loud: Platform, start: Start, tmp_path: Path
) -> None:
    start()
    owner = loud_owner(loud)

    def begun(name: str, kind: str = "ingest.note", steps: int = 2000) -> str:
        job_id = a_job(loud, owner, kind, file=str(tmp_path / name), steps=steps)
        until((tmp_path / name).exists)
        return job_id

    killed = begun("killed", steps=40)
    os.kill(worker_pid(loud, killed), signal.SIGKILL)
    until(lambda: job(loud, killed).state == "succeeded")
    assert job(loud, killed).attempt == 2
    stopped = begun("stopped")
    act(loud, cancel, stopped, "wrong bag")
    until(lambda: job(loud, stopped).state == "cancelled")
    frozen = begun("frozen", "ingest.freeze")
    pid = worker_pid(loud, frozen)
    act(loud, terminate, frozen, "it hears nothing")
    assert job(loud, frozen).state == "cancelled"
    until(lambda: not is_running(pid))
    after = begun("after", steps=1)
    until(lambda: job(loud, after).state == "succeeded")
    assert job(loud, frozen).attempt == 1


def test_wake_ups_lost_with_the_broker_are_sent_again(loud: Platform, start: Start, tmp_path: Path) -> None:
    jobs = [a_job(loud, loud_owner(loud), "ingest.note", file=str(tmp_path / str(n))) for n in range(20)]
    broker = Redis.from_url(loud.settings.broker.url)
    assert broker.llen("ingest") > 0, "there is something to lose"
    broker.flushdb()
    start()
    until(lambda: all(job(loud, one).state == "succeeded" for one in jobs))
    assert [job(loud, one).attempt for one in jobs] == [1] * 20


def test_a_job_beyond_its_time_limit_fails_and_says_so(loud: Platform, start: Start, tmp_path: Path) -> None:
    loud.settings.__dict__["jobs"] = replace(loud.settings.jobs, time_limit_s=1.0)
    start()
    job_id = a_job(loud, loud_owner(loud), "ingest.freeze", file=str(tmp_path / "a"))
    until(lambda: job(loud, job_id).state == "failed")
    assert (job(loud, job_id).failure_code, job(loud, job_id).attempt) == ("time_limit", 1)


def test_a_worker_that_is_told_to_stop_finishes_what_it_can_and_gives_back_the_rest(
    loud: Platform, start: Start, tmp_path: Path
) -> None:
    loud.settings.__dict__["jobs"] = replace(loud.settings.jobs, drain_s=2.0)
    worker = start()
    owner = loud_owner(loud)
    short = a_job(loud, owner, "ingest.note", file=str(tmp_path / "short"), steps=20)
    endless = a_job(loud, owner, "ingest.freeze", file=str(tmp_path / "endless"))
    until(lambda: (tmp_path / "short").exists() and (tmp_path / "endless").exists())
    tries = job(loud, endless).attempts_left
    worker.terminate()
    late = a_job(loud, owner, "ingest.note", file=str(tmp_path / "late"))
    assert worker.wait(PATIENCE_S) == 0
    assert (job(loud, short).state, job(loud, short).attempt) == ("succeeded", 1)
    assert (job(loud, endless).state, job(loud, endless).attempts_left) == ("queued", tries + 1), "at no cost"
    assert job(loud, late).state == "queued", "nothing new was begun"
    with loud.database.reading() as session:
        ended = session.get_one(JobAttempt, (endless, 1))
    assert (ended.outcome, ended.failure_code) == ("lost", "worker_stopped")


def loud_owner(platform: Platform) -> str:
    """An owner, a new one each time."""
    return an_owner(platform, os.urandom(4).hex())


def worker_pid(platform: Platform, job_id: str) -> int:
    """The process at work on the job."""
    with platform.database.reading() as session:
        return int(session.get_one(JobAttempt, (job_id, job(platform, job_id).attempt)).worker.rpartition(":")[2])


def test_idle_processes_say_that_they_are_there_and_when_they_leave(loud: Platform, start: Start) -> None:
    worker = start()
    until(lambda: len(present(loud)) == 2)
    assert {row.queues for row in present(loud)} == {"ingest"}
    beats = min(row.beats for row in present(loud))
    until(lambda: min(row.beats for row in present(loud)) > beats)
    worker.terminate()
    until(lambda: present(loud) == [])


def present(platform: Platform) -> list[Worker]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Worker)))
