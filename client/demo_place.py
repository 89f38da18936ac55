"""The platform that a demo goes to: one that was started for it here, or one that stands elsewhere.

**Conventions.** The benchmark's part needs an administrator. Here that is the first one, while the password that was
written down at the first start is still theirs; elsewhere whoever the token speaks for, if it may administrate.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

from client.api import Api
from client.credentials import Server
from client.errors import ServerRefusedError
from client.signing_in import administering
from services.runtime.embedded.first_start import PASSWORD_FILE
from services.runtime.embedded.supervisor import Running

UNKNOWN_PASSWORD = 401
Administering = Callable[[], AbstractContextManager[Api | None]]


@dataclass(frozen=True)
class Place:
    """A platform that answers; `administering()` opens its API to an administrator, or yields None."""

    server: Server
    administering: Administering


def place_of(platform: Running | Server) -> Place:
    """The platform, once it answers. Raises `StartFailedError`."""
    if isinstance(platform, Server):
        return Place(platform, lambda: _by_token(platform))
    platform.wait_until_ready()
    return Place(Server(platform.url, platform.keys.token), lambda: _by_first_password(platform))


@contextmanager
def _by_token(server: Server) -> Iterator[Api | None]:
    with Api(server) as api:
        yield api if "admin" in api.read("/me")["scopes"] else None


@contextmanager
def _by_first_password(running: Running) -> Iterator[Api | None]:
    path = running.platform.settings.root / PASSWORD_FILE
    with ExitStack() as stack:
        api = None
        if path.exists():
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
