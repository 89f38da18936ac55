"""Platforms whose collection spares nothing: whatever may be collected is collected."""

from dataclasses import replace

import pytest

from services.runtime.platform import Platform
from services.runtime.store.factory import open_store
from testing.servers.fixtures import having


@pytest.fixture
def hasty(platform: Platform) -> Platform:
    return having(platform, store={"grace_s": 0.0})


@pytest.fixture
def hasty_on(platform_on: Platform) -> Platform:
    """`hasty`, on both databases."""
    return having(platform_on, store={"grace_s": 0.0})


@pytest.fixture(params=["folder", "s3"])
def anywhere(request: pytest.FixtureRequest, hasty: Platform) -> Platform:
    """`hasty`, on each store."""
    return in_bucket(request, hasty) if request.param == "s3" else hasty


def in_bucket(request: pytest.FixtureRequest, platform: Platform) -> Platform:
    store = replace(request.getfixturevalue("s3_settings"), grace_s=0.0)
    settings = platform.settings.model_copy(update={"store": store})
    return replace(platform, settings=settings, store=open_store(settings))
