"""The server that the demo uses: one started for it on this machine, or a remote one.

**Conventions.** The benchmark's part needs an administrator. Here that is the first one, while the password that was
written down at the first start is still theirs; elsewhere whoever the token speaks for, if it may administrate.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

from services.runtime.embedded.first_start import first_password_file
from services.runtime.embedded.supervisor import RunningPlatform
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerRefusedError
from stone_client.sign_in import administering

UNKNOWN_PASSWORD = 401
Administering = Callable[[], AbstractContextManager[Api | None]]


@dataclass(frozen=True)
class DemoServer:
    """A platform that answers; `administering()` opens its API to an administrator, or yields None."""

    server: Server
    administering: Administering


def demo_server_of(platform: RunningPlatform | Server) -> DemoServer:
    """The platform, once it answers. Raises `StartFailedError`."""
    if isinstance(platform, Server):
        return DemoServer(platform, lambda: _by_token(platform))
    platform.wait_until_ready()
    return DemoServer(Server(platform.url, platform.keys.token), lambda: _by_first_password(platform))


@contextmanager
def _by_token(server: Server) -> Iterator[Api | None]:
    with Api(server) as api:
        yield api if "admin" in api.read("/me")["scopes"] else None


@contextmanager
def _by_first_password(running: RunningPlatform) -> Iterator[Api | None]:
    path = first_password_file(running.platform.settings)
    with ExitStack() as stack:
        api = None
        if path:
            signed_in = administering(running.url, running.keys.name, path.read_text("utf-8").strip())
            with _unless_the_password_is_another():
                api = stack.enter_context(signed_in)
        yield api


@contextmanager
def _unless_the_password_is_another() -> Iterator[None]:
    try:
        yield
    except ServerRefusedError as error:
        if error.status != UNKNOWN_PASSWORD:
            raise
