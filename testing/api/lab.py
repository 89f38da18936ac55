"""A platform whose users sign in with a provider, served at the address in its settings."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from api.main import make_api
from services.runtime.oidc.settings import OidcSettings
from services.runtime.platform import Platform
from testing.api.serving import serving
from testing.servers.process import free_port


@dataclass(frozen=True)
class Lab:
    """The platform with its provider, and its address."""

    platform: Platform
    url: str


@contextmanager
def served_lab(
    platform: Platform, oidc: OidcSettings, make: Callable[[Platform], Any] = make_api, **api: Any
) -> Iterator[Lab]:
    """Serve the application made by `make` for `platform`, with these settings of a provider and of the API."""
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    changed = {"oidc": oidc, "api": replace(platform.settings.api, url=url, sign_ins_per_minute=1000, **api)}
    lab = Platform(platform.settings.model_copy(update=changed), platform.database, platform.store)
    with serving(lab, make(lab), port):
        yield Lab(lab, url)
