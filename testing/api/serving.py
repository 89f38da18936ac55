"""The real application on a real socket, and people to call it.

**Conventions.** `serving(platform)` yields the base URL of a uvicorn in a thread of this process; `person(platform,
role)` makes a user with a token. Clients are plain `httpx`.
"""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import uvicorn

from api.main import make_api
from api.middleware.heads import BoundedHeads
from services.runtime.access import roles, tokens, users
from services.runtime.orm import new_id
from services.runtime.platform import Platform

STARTS_WITHIN_S = 300.0
ENDS_WITHIN_S = 20.0
ANSWERS_WITHIN_S = 300.0


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
    """A fresh user of this role; `token` may set `scopes` and `expires_s` of the token."""
    with platform.database.transaction() as session:
        user = users.create_user(session, name or f"{role}-{new_id()[-8:]}", role)
        held = token.get("scopes", roles.SCOPES_OF[role])
        secret = tokens.issue(session, user, "test", held, token.get("expires_s", 3600.0))
    return Person(user.id, user.name, secret)


@contextmanager
def serving(platform: Platform, application: Any = None, port: int = 0) -> Iterator[str]:
    """The base URL of the application of `platform`, served until the end of the block; port 0 is any free one."""
    with socket.create_server(("127.0.0.1", port)) as listening:
        app = make_api(platform) if application is None else application
        config = uvicorn.Config(
            app, http=BoundedHeads, log_config=None, ws="none", lifespan="off", timeout_graceful_shutdown=2
        )
        server = uvicorn.Server(config)
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
            server.should_exit = True
            thread.join(ENDS_WITHIN_S)


@contextmanager
def client_of(platform: Platform, caller: Person | None = None) -> Iterator[httpx.Client]:
    """A client of the served application, as `caller`."""
    # Plain HTTP: reading the certificates of the world for each client would take longer than many a test.
    with serving(platform) as url, httpx.Client(base_url=url, timeout=ANSWERS_WITHIN_S, verify=False) as client:
        client.headers.update(caller.headers if caller else {})
        yield client
