"""The three tiers of the tests: `make test`, `make check` and `make test-all`.

**Conventions.** `make test` skips tests marked `whole` or `release`, `make check` those marked `release`. A test is
`whole` if it costs more than a CPU second (`pytest --costs FILE`). It is marked so, lies below one of `WHOLE_FOLDERS`,
uses one of `DEAR_FIXTURES`, or runs on PostgreSQL or S3 what runs on SQLite and in a folder too. `everyday` keeps such
a test in every tier.

`release` marks a test of several CPU seconds that repeats a program of its own (`make chaos`, `make bench-movers`) or
one behaviour for further kinds. Its docstring, or its module's, names the faults that it alone detects; run it before a
release. Files with costly tests come first, so that none of them starts late. A file that is `whole` or `release` as a
whole is not even loaded under `-m "not whole"`.
"""

import re
from functools import cache
from pathlib import Path

import pytest

DEAR_FIXTURES = frozenset({"browser", "postgres_server", "s3_server"})
DEAR_KINDS = frozenset({"postgres", "s3"})  # as named by parameters of fixtures and tests
WHOLE_FOLDERS = {  # with the faults that only their tests detect
    "benchmarks": "figures that are measured wrongly",
    "chaos": "kill tests that would see nothing",
    "deploy": "images, charts and dashboards that do not fit the programs",
    "docsite": "pages of the documentation that are not built or not found",
    "fuzz": "bytes that a fuzzer once found and that break a reader again",
    "services/labeler/exports": "files that programs of others do not open",
    "services/runtime/backup": "a backup that is not restored as it was",
}
TESTS = Path(__file__).resolve().parents[1] / "tests"
TIERS = ("release", "whole", "everyday")
EVERYDAY_ONLY = "not whole"
WHOLE_FILE = re.compile(r"^pytestmark = pytest\.mark\.(whole|release)$", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    is_test = collection_path.suffix == ".py" and collection_path.name.startswith("test_")
    if is_test and config.getoption("markexpr") == EVERYDAY_ONLY and is_whole_file(collection_path):
        return True
    return None


def is_whole_file(path: Path) -> bool:
    """Return whether all tests of the file are skipped every day."""
    text = path.read_text("utf-8")
    return "mark.everyday" not in text and (WHOLE_FILE.search(text) is not None or is_in_whole_folder(path))


@cache
def is_in_whole_folder(path: Path) -> bool:
    return path.is_relative_to(TESTS) and any(path.is_relative_to(TESTS / folder) for folder in WHOLE_FOLDERS)


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        is_released = item.get_closest_marker("release") is not None
        if (is_dear(item) and item.get_closest_marker("everyday") is None) or is_released:
            item.add_marker(pytest.mark.whole)
    first = {item.path for item in items if any(item.get_closest_marker(tier) for tier in TIERS)}
    items.sort(key=lambda item: _turn(item.path, first))


def is_dear(item: pytest.Item) -> bool:
    """Return whether it needs a server or a program that everyday tests do not start."""
    if not isinstance(item, pytest.Function):
        return False
    kinds = item.callspec.params.values() if hasattr(item, "callspec") else ()
    is_of_dear_kind = not DEAR_KINDS.isdisjoint(str(kind) for kind in kinds)
    return is_of_dear_kind or not DEAR_FIXTURES.isdisjoint(item.fixturenames) or is_in_whole_folder(item.path)


def _turn(path: Path, first: set[Path]) -> int:
    return 0 if path in first else 1
