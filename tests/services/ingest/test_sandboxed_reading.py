"""A recording that takes over its reader gains nothing: its job fails with a code, its upload stays, nothing else."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from numba import njit

from services.ingest import sandboxed_inspection, sandboxed_synchronisation
from services.runtime.platform import Platform
from services.runtime.sandbox import SandboxLimits, job_sandbox, sandboxed
from services.runtime.sandbox.result_files import packed
from services.runtime.store.workspace import Workspace
from services.runtime.uploads import upload_file
from testing.worlds.drives import drive, registered_platform
from testing.worlds.runs import Brought, bring, run_all

Attack = Callable[..., object]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


def left_apart(brought: Brought, job_id: str) -> list[Path]:
    run = brought.job(job_id).root_id
    return list(Workspace(brought.platform.store, brought.platform.settings, run).folder.glob(".apart-*"))


def dropped(*_: object, **__: object) -> object:
    return Path(os.environ["STONE_TEST_DROPPED"]).write_bytes(b"left behind")


ATTACKS: dict[str, tuple[Attack, str]] = {
    "a connection": (lambda *_, **__: socket.create_connection(("127.0.0.1", 9)), "raised PermissionError"),
    "a fork": (lambda *_, **__: os.fork(), "raised PermissionError"),
    "a crash": (lambda *_, **__: os._exit(11), "ended with code 11"),
    "all memory": (lambda *_, **__: bytearray(2 * job_sandbox.MEMORY_BYTES), "needed more than"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_recording_whose_reader_is_taken_over_fails_its_job_and_is_kept(
    platform: Platform, bag: Path, attack: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, fate = ATTACKS[attack]
    monkeypatch.setattr(sandboxed_inspection, "inspected_in", work)
    brought = bring(platform)
    job_id = brought.add(bag, "run.mcap")
    run_all(platform)
    job, recording = brought.job(job_id), brought.recording()
    assert (job.state, job.failure_code, job.attempt) == ("failed", "reader_crashed", 1)
    assert fate in job.failure
    assert recording.state == "received", "a fault that may be ours costs nobody their upload"
    assert upload_file(platform.settings, recording.files[0].upload_id or "").read_bytes() == bag.read_bytes()
    assert left_apart(brought, job_id) == []


def test_a_reader_that_writes_elsewhere_is_refused(
    platform: Platform, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STONE_TEST_DROPPED", str(tmp_path / "dropped"))
    monkeypatch.setattr(sandboxed_inspection, "inspected_in", dropped)
    brought = bring(platform)
    job_id = brought.add(bag, "run.mcap")
    run_all(platform)
    assert brought.job(job_id).state == "failed"
    assert not (tmp_path / "dropped").exists()


@pytest.mark.parametrize(
    "record",
    [
        {},
        {"inspection": {}, "quality": {"score": 1}, "topics": 1, "findings": 1, "recovered": []},
        {"inspection": {"findings": []}, "quality": {"score": 1}, "topics": 1, "findings": 1, "recovered": ["../x"]},
    ],
)
def test_a_reader_that_answers_something_else_is_not_believed(
    platform: Platform, bag: Path, record: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandboxed_inspection, "_look", lambda *_: packed(record))
    brought = bring(platform)
    job_id = brought.add(bag, "run.mcap")
    run_all(platform)
    assert (brought.job(job_id).failure_code, brought.recording().state) == ("reader_crashed", "received")


@pytest.mark.whole
def test_a_sequence_is_made_apart_too(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandboxed_synchronisation, "sequence_in", ATTACKS["a connection"][0])
    with registered_platform(tmp_path_factory, tmp_path / "platform") as brought:
        run_id = brought.process()
        run_all(brought.platform)
        assert {job.failure_code for job in brought.jobs(run_id) if job.state == "failed"} == {"reader_crashed"}


def test_what_is_compiled_apart_is_used_and_not_kept(tmp_path: Path) -> None:
    @njit(cache=True)
    def doubled(number):  # type: ignore[no-untyped-def]
        return 2 * number

    answer = sandboxed(lambda: str(doubled(21)).encode(), SandboxLimits(folder=tmp_path, memory_bytes=2**30))
    assert answer == b"42"
    assert not list(Path(__file__).parent.glob("__pycache__/test_sandboxed_reading.*doubled*.nbi"))
