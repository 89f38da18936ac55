"""A dataset that was brought to a platform, whose tar nobody opens."""

from pathlib import Path

import pytest

from services.runtime.platform import Platform
from testing.worlds.brought_datasets import TAR_BYTES, BroughtDataset, an_owner, bring_dataset


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    """Bytes that nobody opens here."""
    path = tmp_path / "field.tar"
    path.write_bytes(bytes(TAR_BYTES))
    return path


@pytest.fixture
def brought(platform: Platform, tar: Path) -> BroughtDataset:
    return bring_dataset(platform, tar, an_owner(platform))
