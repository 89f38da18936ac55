"""Whoever is given a thread of an API process is given a connection to the database, however many ask at once."""

import asyncio
from functools import partial
from pathlib import Path
from threading import Barrier, Thread

import pytest
from anyio import to_thread
from anyio.from_thread import start_blocking_portal
from sqlalchemy import text
from starlette.responses import Response

from api.main import make_api
from api.row_readers import by_row_readers
from api.tus.body_stream import THREADS
from services.runtime.database.connections import ALONE, ROW_READERS, UPLOADS, request_threads
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings
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


@pytest.mark.parametrize("pool_size", [1, 20])
def test_all_threads_of_a_process_hold_a_connection_at_once(tmp_path: Path, pool_size: int) -> None:
    platform = opened(make_settings(tmp_path, database=DatabaseSettings(pool_size=pool_size)), [])
    with start_blocking_portal() as portal:
        portal.call(held_by_all, platform, request_threads(pool_size))
    platform.database.close()
