"""The places in which uploads may be: `placed` on SQLite, `placed_on` on SQLite and PostgreSQL."""

from dataclasses import replace

import pytest

from services.runtime.platform import Platform

SLAB_BYTES = 1000
"""Of the tests' files, which have some 10 KB, there are several slabs; of small ones there is one."""


def with_place(platform: Platform, place: str, slab_bytes: int = SLAB_BYTES) -> Platform:
    """The platform, new uploads of which lie in `place`."""
    uploads = replace(platform.settings.uploads, place=place, slab_bytes=slab_bytes)  # type: ignore[arg-type]
    return replace(platform, settings=platform.settings.model_copy(update={"uploads": uploads}))


@pytest.fixture(params=["folder", "store"])
def placed(request: pytest.FixtureRequest, platform: Platform) -> Platform:
    return with_place(platform, request.param)


@pytest.fixture(params=["folder", "store"])
def placed_on(request: pytest.FixtureRequest, platform_on: Platform) -> Platform:
    return with_place(platform_on, request.param)
