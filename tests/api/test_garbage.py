"""The collector passes over what is there for good, and still finds cycles."""

import gc
import subprocess
import sys
import weakref
from collections.abc import Iterator

import pytest

from api.garbage import COLLECTED_AFTER, keep_what_is_loaded

PYTHONS = (700, 10, 10)


class Cycle:
    """Refers to itself."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    yield
    gc.unfreeze()
    keep_what_is_loaded()  # as testing/memory.py has done


def test_what_is_loaded_is_not_looked_at_again() -> None:
    gc.unfreeze()
    gc.set_threshold(*PYTHONS)
    keep_what_is_loaded()
    assert gc.get_freeze_count() > 10_000
    assert gc.get_threshold() == COLLECTED_AFTER
    assert len(gc.get_objects()) < gc.get_freeze_count() / 10


def test_cycles_that_are_made_later_are_freed_before_some_hundred_requests_have_left_theirs() -> None:
    gc.set_threshold(*PYTHONS)
    keep_what_is_loaded()
    first = weakref.ref(Cycle())
    held = [[] for _ in range(COLLECTED_AFTER[0])]  # type: ignore[var-annotated]
    assert first() is None
    assert held


def test_a_process_that_answers_keeps_what_it_has_loaded() -> None:
    asked = (
        "import gc, api.main as m; m.use_fork_server = m.setup_tracing = lambda *_: None;"
        "from types import SimpleNamespace as N; m.told(N(state=N(meters=N(keep_writing=lambda: None))));"
        "print(gc.get_freeze_count())"
    )
    count = subprocess.run([sys.executable, "-c", asked], check=True, capture_output=True, text=True).stdout
    assert int(count) > 10_000
