"""Does an operation again and again, each time with another of its system calls disturbed."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest

from services.runtime.platform import Platform
from services.runtime.settings import Settings
from testing.failing_calls import Disturbed, Fault, apart, disturb
from testing.servers.fixtures import make_settings, opened

FAULTS = pytest.mark.parametrize("fault", list(Fault), ids=lambda fault: fault.name.lower())


IN_MEMORY = Path("/dev/shm")


@contextmanager
def quick_folder() -> Iterator[Path]:
    """A folder in memory, if there is any: thousands of flushes are waited for."""
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if os.access(IN_MEMORY, os.W_OK) else None) as folder:
        yield Path(folder)


def laid_in(folder: Path, settings: Settings) -> Settings:
    """The settings of a copy of the platform in `folder`, with what lies beside it."""
    shutil.copytree(settings.root.parent, folder, symlinks=True, dirs_exist_ok=True)
    return make_settings(folder).model_copy(update={"uploads": settings.uploads})


def each_call(
    prepared: Settings,
    operate: Callable[[Platform], object],
    check: Callable[[Platform, Disturbed], object],
    fault: Fault,
) -> int:
    """Check a copy of the platform, and of what lies beside it, after the operation: with its first call disturbed, its
    second and so on, and last with none; how many calls it has.
    """
    for nth in count(1):
        with quick_folder() as folder:
            settings = laid_in(folder, prepared)
            disturbed = disturb(lambda: operate(opened(settings, [])), folder, nth, fault)  # noqa: B023
            raised = apart(lambda: check(opened(settings, []), disturbed))  # noqa: B023
        assert not raised, f"{fault.name} at call {nth}, {disturbed.hit or 'none'}: {raised}"
        if not disturbed.hit:
            return nth - 1
    raise AssertionError("the operation never came to its end")
