"""A small published dataset in a tar, and its import on a platform."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from services.runtime.platform import Platform
from testing.servers.fixtures import Bells, make_settings, opened
from testing.worlds.brought_datasets import FIELD, BroughtDataset, an_owner, bring_dataset
from testing.worlds.published_datasets import write_published_tar
from testing.worlds.runs import run_all


@pytest.fixture(scope="module")
def tar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_published_tar(tmp_path_factory.mktemp("published") / "field.tar", FIELD)


@pytest.fixture
def brought(platform: Platform, tar: Path) -> BroughtDataset:
    return bring_dataset(platform, tar, an_owner(platform))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path, tar: Path) -> BroughtDataset:
    """The import on a platform that is closed: nobody changes what it left there."""
    settings = make_settings(tmp_path_factory.mktemp("done"))
    settings.root.mkdir(parents=True)
    shutil.copyfile(_sqlite_template, settings.root / "stone.sqlite3")
    platform = opened(settings, [])
    brought = bring_dataset(platform, tar, an_owner(platform))
    run_all(platform)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    platform.database.close()
    return brought


@pytest.fixture
def imported(done: BroughtDataset, tmp_path: Path, bells: Bells) -> Iterator[BroughtDataset]:
    """The same on a copy of that platform."""
    settings = make_settings(tmp_path / "copied")
    shutil.copytree(done.platform.settings.root, settings.root, symlinks=True)
    platform = opened(settings, bells)
    yield replace(done, platform=platform)
    platform.database.close()
