"""Repeats an operation, each time with a different system call disturbed."""

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

SPARSE = 7
FAULTS = pytest.mark.parametrize(
    ("fault", "step"),
    [
        pytest.param(Fault.KILLED, SPARSE, id="killed-sparsely"),
        *(pytest.param(fault, 1, id=fault.name.lower(), marks=pytest.mark.release) for fault in Fault),
    ],
)
"""Every check kills at each `SPARSE`-th call, a release does all at every call."""
IN_MEMORY = Path("/dev/shm")


@contextmanager
def quick_folder() -> Iterator[Path]:
    """Yield a folder in memory, if possible: the tests wait for thousands of flushes."""
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if os.access(IN_MEMORY, os.W_OK) else None) as folder:
        yield Path(folder)


def laid_in(folder: Path, settings: Settings) -> Settings:
    """Copy the platform and the files beside it into `folder`; return the settings of the copy."""
    shutil.copytree(settings.root.parent, folder, symlinks=True, dirs_exist_ok=True)
    return make_settings(folder).model_copy(update={"uploads": settings.uploads})


def each_call(
    prepared: Settings,
    operate: Callable[[Platform], object],
    check: Callable[[Platform, Disturbed], object],
    fault: Fault,
    step: int,
) -> int:
    """Run the operation on fresh copies, disturb every `step`-th call of it in turn, and check each copy afterwards.

    The last run is undisturbed. Return the number of the last call that was disturbed.
    """
    for nth in count(1, step):
        with quick_folder() as folder:
            settings = laid_in(folder, prepared)
            disturbed = disturb(lambda: operate(opened(settings, [])), folder, nth, fault)  # noqa: B023
            raised = apart(lambda: check(opened(settings, []), disturbed))  # noqa: B023
        assert not raised, f"{fault.name} at call {nth}, {disturbed.hit or 'none'}: {raised}"
        if not disturbed.hit:
            return nth - step
    raise AssertionError("the operation never came to its end")
