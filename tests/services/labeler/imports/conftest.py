"""A small published dataset in a tar, and its import on a platform."""

from pathlib import Path

import pytest

from services.runtime.platform import Platform
from testing.worlds.brought_datasets import FIELD, BroughtDataset, an_owner, bring_dataset
from testing.worlds.published_datasets import write_published_tar
from testing.worlds.runs import run_all


@pytest.fixture(scope="module")
def tar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_published_tar(tmp_path_factory.mktemp("published") / "field.tar", FIELD)


@pytest.fixture
def brought(platform: Platform, tar: Path) -> BroughtDataset:
    return bring_dataset(platform, tar, an_owner(platform))


@pytest.fixture
def imported(brought: BroughtDataset) -> BroughtDataset:
    run_all(brought.platform)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    return brought
