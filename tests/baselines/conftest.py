"""Tests of models run where torch is: `make test-baselines`. Elsewhere none is collected."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from testing.worlds.small_export import SmallExport, write_small_export

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py", "*/test_*.py"]


@pytest.fixture(scope="session")
def meadow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A labelled export of nine LiDAR frames; nothing in it may be changed."""
    return write_small_export(tmp_path_factory.mktemp("meadow"), SmallExport("meadow", 9))
