"""The API that tests are served ends at once where nobody is answered, and lets an answer end."""

import gc
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import anyio
import httpx
import pytest
import uvicorn

from services.runtime.platform import Platform
from testing.api.serving import serving

Message = MutableMapping[str, Any]
Send = Callable[[Message], Awaitable[None]]
PATIENCE_S = 300.0


def test_an_answer_that_was_begun_ends_before_the_server_does(platform: Platform) -> None:
    begun, may_end = threading.Event(), threading.Event()

    async def slowly(_scope: Message, _receive: object, send: Send) -> None:
        begun.set()
        while not may_end.is_set():
            await anyio.sleep(0.01)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"whole"})

    with ThreadPoolExecutor() as threads:
        with serving(platform, slowly) as url:
            answer = threads.submit(httpx.get, url, timeout=PATIENCE_S)
            assert begun.wait(PATIENCE_S)
            threading.Timer(0.05, may_end.set).start()
        assert answer.result().content == b"whole"


def test_a_server_that_answers_nobody_waits_for_nothing(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[uvicorn.Server] = []

    async def shutdown(self: uvicorn.Server, sockets: Any = None) -> None:
        waited.append(self)

    monkeypatch.setattr(uvicorn.Server, "shutdown", shutdown)
    with serving(platform):
        pass
    assert not waited


def test_what_was_loaded_before_the_first_test_is_not_searched_for_garbage() -> None:
    assert gc.get_freeze_count() > 10_000
