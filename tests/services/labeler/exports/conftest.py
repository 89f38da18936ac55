"""The drive whose labels are exported."""

import fcntl
from pathlib import Path

import pytest

from tests.services.labeler.exports.made import Labelled, made_labels


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Labelled:
    """Made by the first of the test processes that asks, read by all; nothing in it may be changed."""
    if worker_id == "master":
        return made_labels(tmp_path_factory.mktemp("drive"))
    root = tmp_path_factory.getbasetemp().parent / "labelled-drive"
    root.mkdir(exist_ok=True)
    with (root / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (root / "done").exists():
            made_labels(root)
            (root / "done").touch()
    return Labelled(Path(root / "drive.mcap"), root / "labels")
