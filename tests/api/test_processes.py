"""Threads, connections and memory of an API process: enough for all who ask at once, and none held up for nothing."""

import asyncio
import gc
import subprocess
import sys
import weakref
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Barrier, Event, Lock, Thread

import pytest
from anyio import to_thread
from anyio.from_thread import start_blocking_portal
from sqlalchemy import text
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from api.main import make_api
from api.row_readers import by_row_readers
from api.tus.body_stream import THREADS
from services.runtime.database.transactions import ALONE, ROW_READERS, UPLOADS, request_threads
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
from stone_base.process_tuning import API_COLLECTS_AFTER, exempt_loaded_objects
from testing.servers.fixtures import make_settings, opened

WITHIN_S = 20.0  # less than the pool lets anybody wait


def hold(platform: Platform, all_of_them: Barrier) -> Response:
    """Hold a connection until everybody has one. Raises `BrokenBarrierError` where somebody gets none."""
    with platform.database.reading() as session:
        session.execute(text("SELECT 1"))
        all_of_them.wait(WITHIN_S)
    return Response()


async def held_by_all(platform: Platform, requests: int) -> None:
    """As many ask as there are threads of each kind."""
    at_once = Barrier(requests + ROW_READERS + UPLOADS + ALONE)
    api = make_api(platform)
    for _ in range(ALONE):
        Thread(target=hold, args=(platform, at_once), daemon=True).start()
    async with api.router.lifespan_context(api):  # as a server does
        assert to_thread.current_default_thread_limiter().total_tokens == requests
        asked = partial(hold, platform, at_once)
        loop = asyncio.get_running_loop()
        answers = [to_thread.run_sync(asked) for _ in range(requests)]
        answers += [by_row_readers(asked)() for _ in range(ROW_READERS)]
        await asyncio.gather(*answers, *(loop.run_in_executor(THREADS, asked) for _ in range(UPLOADS)))


@pytest.mark.whole
@pytest.mark.parametrize("pool_size", [1, 20])
def test_all_threads_of_a_process_hold_a_connection_at_once(tmp_path: Path, pool_size: int) -> None:
    platform = opened(make_settings(tmp_path, database=DatabaseSettings(pool_size=pool_size)), [])
    with start_blocking_portal() as portal:
        portal.call(held_by_all, platform, request_threads(pool_size))
    platform.database.close()


class Readings:
    """What is at work, the most that ever was, and who began in which order."""

    def __init__(self) -> None:
        self.at_work = self.most = 0
        self.begun, self.lock, self.go_on = list[int](), Lock(), Event()

    def read(self, number: int) -> Response:
        with self.lock:
            self.begun.append(number)
            self.at_work += 1
            self.most = max(self.most, self.at_work)
        assert self.go_on.wait(WITHIN_S)
        with self.lock:
            self.at_work -= 1
        return Response(str(number))


async def while_reading(readings: Readings, requests: int) -> list[bytes]:
    read = by_row_readers(readings.read)
    asked = [asyncio.create_task(read(number)) for number in range(requests)]
    while len(readings.begun) < ROW_READERS:
        await asyncio.sleep(0.001)
    await asyncio.wait_for(run_in_threadpool(lambda: None), WITHIN_S)  # as other routes are answered
    assert readings.at_work == ROW_READERS
    readings.go_on.set()
    return [bytes(answer.body) for answer in await asyncio.gather(*asked)]


def test_a_few_at_a_time_read_in_the_order_in_which_they_came_beside_everything_else() -> None:
    for _ in range(2):  # event loops, which share no threads
        readings = Readings()
        with start_blocking_portal() as portal:  # a loop of its own: a browser's may run in this thread
            answers = portal.call(while_reading, readings, 40)
        assert answers == [b"%d" % number for number in range(40)]
        assert readings.most == ROW_READERS
        assert sorted(readings.begun[:ROW_READERS]) == list(range(ROW_READERS))


@pytest.mark.whole
def test_what_is_refused_while_it_is_read_is_refused() -> None:
    def refuse() -> Response:
        raise KeyError("gone")

    async def asked() -> list[BaseException | Response]:
        return await asyncio.gather(*(by_row_readers(refuse)() for _ in range(2 * ROW_READERS)), return_exceptions=True)

    with start_blocking_portal() as portal:
        assert [type(one) for one in portal.call(asked)] == [KeyError] * 2 * ROW_READERS


PYTHONS = (700, 10, 10)


class Cycle:
    """Refers to itself."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    yield
    gc.unfreeze()
    exempt_loaded_objects()  # as testing/memory.py has done


@pytest.mark.whole
def test_what_is_loaded_is_not_looked_at_again() -> None:
    gc.unfreeze()
    gc.set_threshold(*PYTHONS)
    exempt_loaded_objects()
    assert gc.get_freeze_count() > 10_000
    assert gc.get_threshold() == API_COLLECTS_AFTER
    assert len(gc.get_objects()) < gc.get_freeze_count() / 10


@pytest.mark.whole
def test_cycles_that_are_made_later_are_freed_before_some_hundred_requests_have_left_theirs() -> None:
    gc.set_threshold(*PYTHONS)
    exempt_loaded_objects()
    first = weakref.ref(Cycle())
    held = [[] for _ in range(API_COLLECTS_AFTER[0])]  # type: ignore[var-annotated]
    assert first() is None
    assert held


@pytest.mark.whole
def test_a_process_that_answers_keeps_what_it_has_loaded_which_is_neither_solver_nor_plots() -> None:
    asked = (
        "from types import SimpleNamespace as N; import gc, sys, api.main as m; m.setup_tracing = lambda *_: None;"
        "m.use_fork_server = lambda *_: N(ensure_running=lambda: None);"
        "m.configure_process(N(state=N(meters=N(keep_writing=lambda: None))));"
        "print(gc.get_freeze_count(), *{'scipy', 'matplotlib', 'numba', 'open3d'} & {*sys.modules})"
    )
    count, *loaded = subprocess.run([sys.executable, "-c", asked], check=True, capture_output=True).stdout.split()
    assert int(count) > 10_000
    assert loaded == []
