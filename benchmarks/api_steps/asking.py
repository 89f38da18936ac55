"""Clients that note the processor time of each request: over a connection, or of an application in this process.

**Conventions.** One request at a time, so what a process used meanwhile was the request's. Times are CPU milliseconds.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import anyio.to_thread
from starlette.types import ASGIApp, Message

from api.tus import body_stream
from benchmarks.api_steps.steps import StepSamples
from benchmarks.load.clients import Client, LoadLog, LoadPlan, LoadReply


@dataclass
class CpuCosts:
    """Of each kind: how many requests, and what they cost the server and the client."""

    server_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    client_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


class MeasuredClient(Client):
    """A client of a server whose processor time `server_s` tells."""

    def __init__(
        self, plan: LoadPlan, secret: str, server_s: Callable[[], float], costs: CpuCosts, team: str = ""
    ) -> None:
        super().__init__(plan, secret, LoadLog(), team)
        self._server_s, self._costs = server_s, costs

    async def ask(self, what: str, method: str, path: str, expected: tuple[int, ...], **said: Any) -> LoadReply:
        before = self._server_s(), time.process_time()
        reply = await super().ask(what, method, path, expected, **said)
        self._costs.server_ms[what].append((self._server_s() - before[0]) * 1e3)
        self._costs.client_ms[what].append((time.process_time() - before[1]) * 1e3)
        return reply


class InProcessClient(MeasuredClient):
    """A client of an application in this process, without sockets."""

    def __init__(
        self, who: tuple[LoadPlan, str, str], app: ASGIApp, costs: CpuCosts, samples: StepSamples | None = None
    ) -> None:
        plan, secret, team = who
        super().__init__(plan, secret, time.process_time, costs, team)
        self._app, self._samples = app, samples or StepSamples()

    async def ask(self, what: str, method: str, path: str, expected: tuple[int, ...], **said: Any) -> LoadReply:
        self._samples.kind = what
        try:
            return await super().ask(what, method, path, expected, **said)
        finally:
            self._samples.kind = ""

    async def _sent(self, method: str, path: str, headers: Mapping[str, str], body: bytes) -> LoadReply:
        lines = {"Host": "api", "Authorization": f"Bearer {self._secret}", "Content-Length": str(len(body)), **headers}
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": method,
            "scheme": "http",
            "path": f"/api/v1{path}",
            "raw_path": f"/api/v1{path}".encode(),
            "query_string": b"",
            "root_path": "",
            "headers": [(name.lower().encode(), value.encode()) for name, value in lines.items()],
            "client": ("127.0.0.1", 4711),
            "server": ("127.0.0.1", 80),
        }
        messages: list[Message] = []

        async def receive() -> Message:
            return {"type": "http.request", "body": body, "more_body": False}

        async def send(message: Message) -> None:
            messages.append(message)

        await self._app(scope, receive, send)
        found = {name.decode(): value.decode("latin-1") for name, value in messages[0]["headers"]}
        content = b"".join(message.get("body", b"") for message in messages[1:])
        return LoadReply(messages[0]["status"], found, content)


class _AtOnce(Executor):
    """Does what it is given before it answers."""

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Any:
        done: Future[Any] = Future()
        try:
            done.set_result(function(*given, **named))
        except BaseException as error:
            done.set_exception(error)
        return done


@contextmanager
def without_threads() -> Iterator[None]:
    """Whatever is handed to a thread is done by the thread that hands it over."""

    async def at_once(function: Callable[..., Any], *given: Any, **_options: Any) -> Any:
        return function(*given)

    handed, threads = anyio.to_thread.run_sync, body_stream.THREADS
    anyio.to_thread.run_sync, body_stream.THREADS = at_once, _AtOnce()  # type: ignore[assignment]
    try:
        yield
    finally:
        anyio.to_thread.run_sync, body_stream.THREADS = handed, threads
