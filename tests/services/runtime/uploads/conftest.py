"""The backends that uploads may be in: `placed` on SQLite, `placed_on` on SQLite and PostgreSQL."""

from dataclasses import replace

import pytest

from services.runtime.platform import Platform

PART_BYTES = 1000
"""Of the tests' files, which have some 10 KB, there are several parts; of small ones there is one."""


def with_place(platform: Platform, place: str, part_bytes: int = PART_BYTES) -> Platform:
    """The platform, new uploads of which lie in `place`."""
    uploads = replace(platform.settings.uploads, backend=place, part_bytes=part_bytes)  # type: ignore[arg-type]
    return replace(platform, settings=platform.settings.model_copy(update={"uploads": uploads}))


@pytest.fixture(params=["folder", "store"])
def placed(request: pytest.FixtureRequest, platform: Platform) -> Platform:
    return with_place(platform, request.param)


@pytest.fixture(params=["folder", "store"])
def placed_on(request: pytest.FixtureRequest, platform_on: Platform) -> Platform:
    return with_place(platform_on, request.param)
