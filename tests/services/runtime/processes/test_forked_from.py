"""What sandboxed children of a worker are to find loaded can be loaded."""

from importlib import import_module

import pytest

from services.runtime.jobs.broker_app import QUEUES
from services.runtime.processes.worker import FORKED_FROM


@pytest.mark.parametrize("queue", QUEUES)
def test_a_fork_server_can_load_what_it_is_told_to(queue: str) -> None:
    for loaded in FORKED_FROM[queue]:
        module, _, function = loaded.partition(":")
        assert not function or callable(getattr(import_module(module), function))
