"""Browsers that reached the platform by https come back by https."""

from dataclasses import replace

import pytest

from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from testing.api.serving import client_of


@pytest.mark.parametrize(
    ("url", "expected"), [("https://stone.example", "max-age=31536000"), ("http://127.0.0.1:8080", None)]
)
def test_the_way_back_is_https_where_the_way_in_was(platform: Platform, url: str, expected: str | None) -> None:
    reached = platform.settings.model_copy(update={"api": ApiSettings(url=url)})
    with client_of(replace(platform, settings=reached)) as api:
        for path in ("/healthz", "/api/v1/me", "/nowhere"):
            assert api.get(path).headers.get("strict-transport-security") == expected
