"""The application as its callers meet it: `api` on the embedded platform, `api_on` on SQLite and PostgreSQL."""

from collections.abc import Iterator

import httpx
import pytest
from argon2 import PasswordHasher

from services.runtime.access import passwords
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from tests.services.runtime.uploads.conftest import with_place


@pytest.fixture(scope="package", autouse=True)
def _light_passwords() -> Iterator[None]:
    """Argon2 that costs little; what it must cost is asserted in tests/services/runtime/access."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passwords, "_hasher", PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))
        passwords._nobodys.cache_clear()
        yield
    passwords._nobodys.cache_clear()


@pytest.fixture
def api(platform: Platform) -> Iterator[httpx.Client]:
    """A client without credentials; say who calls by `headers=somebody.headers`."""
    with client_of(platform) as client:
        yield client


@pytest.fixture
def api_on(platform_on: Platform) -> Iterator[httpx.Client]:
    with client_of(platform_on) as client:
        yield client


@pytest.fixture(params=["folder", "store"])
def placed(request: pytest.FixtureRequest, platform: Platform) -> Platform:
    """`platform`, whose uploads lie in one backend or the other, there in parts of 1 MiB."""
    return with_place(platform, request.param, 1 << 20)


@pytest.fixture
def administrator(platform: Platform) -> Person:
    return person(platform, "administrator")


@pytest.fixture
def curator(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.fixture
def participant(platform: Platform) -> Person:
    return person(platform, "participant")
