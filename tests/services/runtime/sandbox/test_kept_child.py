"""A child does several jobs of one run, and of no other; whatever ends it costs the job at hand, and no limit grows."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from services.runtime.orm import Job
from services.runtime.sandbox import SandboxLimits, SandboxWatch, fences, fork_client, job_sandbox
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.fork_client import ForkServer
from services.runtime.sandbox.job_sandbox import CHILDREN, JobSandbox, RunWork, sandboxed_in_run
from services.runtime.telemetry.process_usage import used_cpu_s
from stone.errors import StoneError
from testing.process_states import is_running, parent_of
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings
from testing.stone_serve import until
from testing.threads import at_once
from testing.worlds.runs import Said
from tests.services.runtime.sandbox import spies

RUN, OTHER = "1" * 32, "2" * 32
ASKER = """
import sys
from functools import partial
from services.runtime.orm import Job
from services.runtime.sandbox import SandboxLimits, UNWATCHED
from services.runtime.sandbox.fork_client import use_fork_server
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.job_sandbox import RunWork, sandboxed_in_run
from testing.threads import at_once
from testing.worlds.runs import Said
from tests.services.runtime.sandbox import spies
use_fork_server([spies.__name__])
work = partial(spies.without_progress, spies.pid)
print(sandboxed_in_run(RunWork("1" * 32, work, SandboxLimits(), UNWATCHED)).decode(), flush=True)
sys.stdin.readline()
"""
needs_landlock = pytest.mark.skipif(fences.version() == 0, reason="this kernel has no Landlock")


@pytest.fixture(scope="module")
def server() -> Iterator[ForkServer]:
    made = ForkServer((spies.__name__,))
    yield made
    made.close()


@pytest.fixture(autouse=True)
def _served(server: ForkServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(fork_client, "_SERVERS", [server])
    yield
    CHILDREN.close()


def asked(
    work: Callable[[], bytes],
    run_id: str = RUN,
    limits: SandboxLimits | None = None,
    watch: SandboxWatch | None = None,
) -> bytes:
    """What a child of the run answers."""
    task = partial(spies.without_progress, work)
    return sandboxed_in_run(RunWork(run_id, task, limits or SandboxLimits(), watch or SandboxWatch()))


def test_the_jobs_of_a_run_share_a_child() -> None:
    assert asked(spies.pid) == asked(spies.pid) == asked(spies.pid)


def test_a_child_never_sees_two_runs() -> None:
    first = asked(spies.pid)
    assert asked(spies.pid, OTHER) != first
    assert not is_running(int(first))
    assert asked(spies.pid) != first


def test_a_job_that_needs_more_than_the_child_was_given_has_another(tmp_path: Path) -> None:
    first = asked(spies.pid)
    wider = asked(spies.pid, limits=SandboxLimits(reads=(tmp_path,)))
    assert wider != first
    assert asked(spies.pid) == wider, "it was given more than this job needs"
    assert asked(spies.pid, limits=SandboxLimits(memory_bytes=2**20)) != wider
    assert asked(spies.pid, limits=SandboxLimits(folder=tmp_path, file_bytes=1)) != wider


def test_a_recording_that_was_fetched_anew_is_given_to_another_child(tmp_path: Path) -> None:
    recording, fetched = tmp_path / "recording", tmp_path / "fetched"
    recording.write_text("a recording")
    limits = SandboxLimits(reads=(recording,))
    first = asked(spies.pid, limits=limits)
    fetched.write_text("a recording")
    fetched.replace(recording)
    assert asked(spies.pid, limits=limits) != first


@needs_landlock
def test_a_later_job_reads_what_the_run_was_given_and_nothing_else(tmp_path: Path) -> None:
    given, another = tmp_path / "given", tmp_path / "another"
    for path in (given, another):
        path.write_text("a recording")
    limits = SandboxLimits(reads=(given,))
    asked(spies.pid, limits=limits)
    assert asked(partial(spies.readable, (given, another, tmp_path)), limits=limits).decode() == str(given)
    assert asked(partial(spies.readable, (given, another)), OTHER) == b""
    assert asked(spies.reachable) == b"nothing"


def test_a_refusal_ends_no_child() -> None:
    first = asked(spies.pid)
    with refused_as("corrupt"):
        asked(spies.refuse)
    assert asked(spies.pid) == first


def test_what_earlier_jobs_broke_is_asked_of_a_fresh_child() -> None:
    first = asked(spies.remember)
    second = asked(spies.end_if_remembered)
    assert second != first
    assert asked(spies.pid) == second


def test_what_breaks_a_fresh_child_too_is_refused_with_its_signal(tmp_path: Path) -> None:
    limits = SandboxLimits(folder=tmp_path, file_bytes=2**20)
    first = asked(spies.pid, limits=limits)
    with pytest.raises(SandboxCrashedError, match="SIGBUS"):
        asked(partial(spies.bus_error, tmp_path), limits=limits)
    assert asked(spies.pid, limits=limits) != first


def test_a_job_whose_child_is_killed_from_outside_is_lost_and_the_next_has_a_fresh_one() -> None:
    first = asked(spies.pid)
    with pytest.raises(SandboxInterruptedError):
        asked(partial(spies.end_by, signal.SIGKILL))
    assert asked(spies.pid) != first


@pytest.mark.parametrize("victim_of", [int, lambda child: parent_of(int(child))], ids=["child", "fork server"])
def test_a_child_that_ended_between_two_jobs_costs_none(victim_of: Callable[[bytes], int]) -> None:
    first = asked(spies.pid)
    os.kill(victim_of(first), signal.SIGKILL)
    until(lambda: not is_running(int(first)))
    assert asked(spies.pid) != first


def test_a_later_job_has_the_wall_time_of_any_and_no_more(tmp_path: Path) -> None:
    limits = SandboxLimits(folder=tmp_path, file_bytes=100, wall_s=2.0)
    first = asked(spies.pid, limits=limits)
    with pytest.raises(SandboxInterruptedError, match="2 s of wall"):
        asked(partial(spies.sleep, tmp_path / "told"), limits=limits)
    assert not is_running(int(first))


@pytest.mark.whole
def test_a_later_job_has_the_processor_time_of_any_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches alone a kept child whose jobs take from each other's processor time, or have no limit of their own."""
    monkeypatch.setattr(job_sandbox, "MOST_USED_S", 1)
    limits = SandboxLimits(cpu_s=1)
    first = asked(partial(spies.spin, 0.5), limits=limits)
    assert asked(partial(spies.spin, 0.7), limits=limits) == first
    assert asked(spies.pid, limits=limits) != first, "it had used more than a kept one may"
    with pytest.raises(SandboxCrashedError, match="1 s of processor"):
        asked(partial(spies.spin, 600.0), limits=limits)


def test_a_later_job_has_the_memory_of_any_and_no_more() -> None:
    limits = SandboxLimits(memory_bytes=64 * 2**20)
    first = asked(partial(spies.allocate, 40 * 2**20), limits=limits)
    assert asked(partial(spies.allocate, 40 * 2**20), limits=limits) == first
    with pytest.raises(SandboxCrashedError, match="64 MiB"):
        asked(partial(spies.allocate, 100 * 2**20), limits=limits)


def test_a_child_that_holds_much_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_sandbox, "MOST_HELD_BYTES", 0)
    first = asked(spies.pid)
    assert not is_running(int(first))
    assert asked(spies.pid) != first


def test_an_idle_child_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_sandbox, "IDLE_S", 0.01)
    first = asked(spies.pid)
    until(lambda: not is_running(int(first)))
    assert asked(spies.pid) != first


def test_a_child_whose_job_is_to_stop_is_ended(tmp_path: Path) -> None:
    limits = SandboxLimits(folder=tmp_path, file_bytes=100)
    first = asked(spies.pid, limits=limits)

    def stop() -> None:
        raise StoneError("it is to stop")

    with pytest.raises(StoneError, match="it is to stop"):
        asked(partial(spies.sleep, tmp_path / "told"), limits=limits, watch=SandboxWatch(on_poll=stop))
    assert not is_running(int(first))


def test_an_answer_that_was_not_asked_for_is_no_answer_to_the_next_job() -> None:
    assert asked(partial(spies.answer_twice, b"another")) == b"another"
    until(lambda: CHILDREN._kept is None or not CHILDREN._kept.process.is_waiting)
    assert asked(spies.pid) != b"the answer"


def test_what_a_kept_child_uses_is_counted_with_the_job_that_used_it() -> None:
    asked(spies.pid)
    before = used_cpu_s()
    child = asked(partial(spies.spin, 0.4))
    counted = used_cpu_s() - before
    assert counted >= 0.38, "in ticks of 10 ms"
    assert is_running(int(child))
    CHILDREN.close()
    assert used_cpu_s() - before < counted + 0.3, "and once only"


def test_two_threads_do_not_wait_for_each_other() -> None:
    found = at_once(2, lambda _: asked(partial(spies.spin, 0.2)))
    assert len(set(found)) == 2
    assert asked(spies.pid) in found


def test_a_job_that_shares_no_child_waits_for_none_beside_it(tmp_path: Path) -> None:
    settings = make_settings(tmp_path)
    sharing = JobSandbox(tmp_path, (), Said(Job(root_id=RUN)), settings, lambda: None, shares_run=True)
    first = sharing.run(spies.pid_in, "stage", 1)
    assert sharing.run(spies.pid_in, "stage", 1) == first
    alone = replace(sharing, shares_run=False).run(spies.pid_in, "stage", 1)
    assert alone != first
    assert not is_running(int(first))


def test_work_of_many_bytes_has_a_child_of_its_own() -> None:
    first = asked(spies.pid)
    assert asked(partial(spies.answer_of, b"x" * 2 * job_sandbox.LONGEST_BYTES)) != first
    assert asked(spies.pid) == first


def test_without_a_fork_server_every_job_has_a_child_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_client, "_SERVERS", [])
    assert asked(spies.pid) != asked(spies.pid)


@pytest.mark.whole
def test_a_kept_child_ends_with_its_service() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ASKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as asker:
        assert asker.stdout is not None
        child = int(asker.stdout.readline())
        assert is_running(child)
        asker.kill()
        asker.wait()
    until(lambda: not is_running(child))
