"""Jobs of a run that follow each other in one sandboxed child leave what each would leave in a child of its own.

Catches alone labels that depend on what an earlier job left in the memory of its child.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.runtime.database.migrate import upgrade
from services.runtime.processes.worker import FORKED_FROM
from services.runtime.sandbox import SandboxLimits, fork_client, kept_child
from services.runtime.sandbox.fork_client import ForkServer
from services.runtime.sandbox.kept_child import CHILDREN
from services.runtime.sandbox.parent import SandboxProcess
from testing.servers.fixtures import make_settings, opened
from testing.worlds.runs import bring_ready, differing, run_all, simulated

pytestmark = pytest.mark.whole


@pytest.fixture
def server() -> Iterator[ForkServer]:
    made = ForkServer((*FORKED_FROM["ingest"], *FORKED_FROM["labeler"]))
    yield made
    CHILDREN.close()
    made.close()


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> list[SandboxProcess]:
    """Every child that there was."""
    begun, begin = list[SandboxProcess](), SandboxProcess.__init__

    def noted(self: SandboxProcess, *given: object) -> None:
        begun.append(self)
        begin(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(SandboxProcess, "__init__", noted)
    return begun


def made(bag: Path, folder: Path) -> dict[str, bytes]:
    """The files of a run on a platform of its own."""
    settings = make_settings(folder)
    upgrade(settings)
    platform = opened(settings, [])
    brought = bring_ready(platform, bag)
    root_id = brought.process()
    run_all(platform)
    assert (brought.job(root_id).state, {job.attempt for job in brought.jobs(root_id) if job.queue}) == (
        "succeeded",
        {1},
    )
    files = brought.files()
    platform.database.close()
    return files


def test_jobs_that_share_a_child_leave_the_same_bytes(
    server: ForkServer, children: list[SandboxProcess], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = simulated(tmp_path)
    alone = made(bag, tmp_path / "alone")
    of_each_job = len(children)
    children.clear()
    monkeypatch.setattr(fork_client, "_SERVERS", [server])
    shared = made(bag, tmp_path / "shared")
    assert differing(shared, alone) == []
    assert len(alone) > 60
    assert len(children) < of_each_job / 2


def test_the_child_that_names_the_jobs_may_do_the_first_of_them(
    server: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever is kept for jobs that read sweeps was given the recording when it was begun."""
    given, begin = list[SandboxLimits](), kept_child.begun_child

    def noted(server: ForkServer, run_id: str, limits: SandboxLimits) -> kept_child.RunChild:
        given.append(limits)
        return begin(server, run_id, limits)

    monkeypatch.setattr(kept_child, "begun_child", noted)
    monkeypatch.setattr(fork_client, "_SERVERS", [server])
    made(simulated(tmp_path), tmp_path / "shared")
    assert given
    assert all(limits.reads for limits in given)
