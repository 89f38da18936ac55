"""The real application on a real socket, and users to call it.

**Conventions.** `serving(platform)` yields the base URL of a uvicorn in a thread of this process; `person(platform,
role)` creates a user with a token. Clients are plain `httpx`.
"""

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import httpx
import uvicorn

from api.main import make_api
from api.middleware.context import COOKIE
from api.middleware.heads import BoundedHeads
from services.runtime.access import roles, sessions, tokens, users
from services.runtime.orm import User, new_id
from services.runtime.platform import Platform
from testing import threads

STARTS_WITHIN_S = 300.0
ENDS_WITHIN_S = 20.0
ANSWERS_WITHIN_S = 300.0
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Person:
    """A user with a token."""

    user_id: str
    name: str
    secret: str

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.secret}"}


def person(platform: Platform, role: str, name: str = "", **token: Any) -> Person:
    """Create a user of this role; `token` may set `scopes` and `expires_s` of the token."""
    with platform.database.transaction() as session:
        user = users.create_user(session, name or f"{role}-{new_id()[-8:]}", role)
        held = token.get("scopes", roles.SCOPES_OF[role])
        secret = tokens.issue(session, user, "test", held, token.get("expires_s", 3600.0))
    return Person(user.id, user.name, secret)


def in_browser(platform: Platform, who: Person) -> dict[str, str]:
    """Return the headers of a browser in which this person has just signed in."""
    with platform.database.transaction() as session:
        opened = sessions.open_session(session, session.get_one(User, who.user_id), 3600.0)
    return {"Cookie": f"{COOKIE}={opened.secret}", "X-CSRF-Token": opened.csrf_token}


class PromptServer(uvicorn.Server):
    """A server that ends immediately: uvicorn checks every tenth of a second, and then waits a second for connections.

    Any thread may call `end` once the server has started.
    """

    _loop: asyncio.AbstractEventLoop
    _told: asyncio.Event

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        self._loop, self._told = asyncio.get_running_loop(), asyncio.Event()
        await super().startup(sockets)

    async def main_loop(self) -> None:
        ticking = asyncio.ensure_future(super().main_loop())
        telling = asyncio.ensure_future(self._told.wait())
        await asyncio.wait((ticking, telling), return_when=asyncio.FIRST_COMPLETED)
        ticking.cancel()
        telling.cancel()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for server in self.servers:
            server.close()
        for listening in sockets or []:
            listening.close()
        # A newly accepted connection enters `connections` two turns of the loop later. If it outlived the loop, its
        # client would receive 400 from a handler whose loop is closed.
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        if self.server_state.connections or self.server_state.tasks:
            await super().shutdown(sockets)

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._told.set)


@contextmanager
def serving(platform: Platform, application: Any = None, port: int = 0) -> Iterator[str]:
    """Serve the application of `platform` during the block and yield the base URL; port 0 selects a free port."""
    with socket.create_server(("127.0.0.1", port)) as listening:
        app = make_api(platform) if application is None else application
        config = uvicorn.Config(
            app, http=BoundedHeads, log_config=None, ws="none", lifespan="off", timeout_graceful_shutdown=2
        )
        server = PromptServer(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        try:
            deadline = time.monotonic() + STARTS_WITHIN_S
            while not server.started:
                assert thread.is_alive(), "the server ended instead of starting"
                assert time.monotonic() < deadline, "the server does not start"
                time.sleep(0.005)
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            if thread.is_alive():
                server.end()
            thread.join(ENDS_WITHIN_S)


@contextmanager
def client_of(platform: Platform, caller: Person | None = None) -> Iterator[httpx.Client]:
    """Yield a client of the served application, as `caller`."""
    # Plain HTTP: loading the certificate authorities for each client would take longer than many a test.
    with serving(platform) as url, httpx.Client(base_url=url, timeout=ANSWERS_WITHIN_S, verify=False) as client:
        client.headers.update(caller.headers if caller else {})
        yield client


def at_once(url: str, times: int, ask: Callable[[httpx.Client, int], Answer]) -> list[Answer]:
    """Return the answers to `times` concurrent requests, each on its own connection."""
    with ExitStack() as stack:
        made = (httpx.Client(base_url=url, timeout=ANSWERS_WITHIN_S, verify=False) for _ in range(times))
        clients = [stack.enter_context(client) for client in made]
        return threads.at_once(times, lambda number: ask(clients[number], number))
