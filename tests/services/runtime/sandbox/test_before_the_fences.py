"""Steps of a child before its fences close: it becomes a separate user and imports modules that read on import."""

import mimetypes
import os
import signal
import sys
from ast import literal_eval
from importlib import import_module
from pathlib import Path

import pytest

from services.runtime.orm import Job
from services.runtime.sandbox import ProgressCallback, SandboxLimits, fences, sandboxed
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from testing.process_states import is_running, parent_of
from testing.servers.fixtures import make_settings
from testing.stone_serve import until
from testing.worlds.runs import Said

needs_landlock = pytest.mark.skipif(fences.version() == 0, reason="this kernel has no Landlock")
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user")
READS_AT_IMPORT = "import mimetypes\nmimetypes.init()\nKNOWN = mimetypes.types_map['.stone']\n"


@pytest.fixture
def _late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Create a library that reads a system file on import, as Open3D reads the list of Debian's `media-types`."""
    listing, packages = tmp_path / "etc" / "mime.types", tmp_path / "packages"
    listing.parent.mkdir()
    listing.write_text("application/x-stone stone\n")
    packages.mkdir()
    (packages / "late_library.py").write_text(READS_AT_IMPORT)
    monkeypatch.setattr(mimetypes, "knownfiles", [str(listing)])
    monkeypatch.syspath_prepend(packages)


def known() -> bytes:
    return str(import_module("late_library").KNOWN).encode()


@needs_landlock
@pytest.mark.usefixtures("_late")
def test_what_reads_a_list_of_the_system_at_its_import_is_imported_before_the_fences_close(tmp_path: Path) -> None:
    reads = (tmp_path / "packages",)
    with pytest.raises(SandboxInterruptedError, match="PermissionError"):
        sandboxed(known, SandboxLimits(reads=reads))
    assert sandboxed(known, SandboxLimits(reads=reads, imports=("late_library",))) == b"application/x-stone"
    assert "late_library" not in sys.modules


def test_an_import_that_fails_is_no_fault_of_the_input() -> None:
    with pytest.raises(SandboxInterruptedError, match="ModuleNotFoundError"):
        sandboxed(lambda: b"", SandboxLimits(imports=("no_such_module",)))


def test_a_process_of_several_threads_is_not_fenced_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter would apply to only one of its threads."""
    (tmp_path / "threaded.py").write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SandboxCrashedError, match="ended with code 1"):
        sandboxed(lambda: b"", SandboxLimits(imports=("threaded",)))


def users() -> bytes:
    return repr((*os.getresuid(), *os.getresgid(), os.getgroups())).encode()


@needs_root
def test_a_child_of_root_is_a_user_that_nobody_else_is() -> None:
    first, second = literal_eval(sandboxed(users).decode()), literal_eval(sandboxed(users).decode())
    for *numbers, groups in (first, second):
        assert len(set(numbers)) == 1
        assert numbers[0] > 2**30
        assert groups == []
    assert first != second


@needs_root
def test_a_child_of_root_keeps_of_its_powers_the_one_to_open_files() -> None:
    status = sandboxed(lambda: Path("/proc/self/status").read_bytes()).decode()
    held = {line.split(":")[0]: int(line.split()[1], 16) for line in status.splitlines() if line.startswith("Cap")}
    assert (held["CapPrm"], held["CapEff"], held["CapInh"], held["CapAmb"]) == (2, 2, 0, 0)


@needs_root
def test_a_child_of_another_user_ends_with_its_parent(tmp_path: Path) -> None:
    """A change of user clears the parent-death signal of a process."""
    told = tmp_path / "told"
    pid = os.fork()
    if pid == 0:

        def work() -> bytes:
            told.write_text(str(os.getpid()))
            signal.pause()
            return b""

        sandboxed(work, SandboxLimits(folder=tmp_path, file_bytes=100))
        os._exit(0)
    until(lambda: told.exists() and told.read_text() != "")
    child = int(told.read_text())
    assert parent_of(child) == pid
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    until(lambda: not is_running(child))


def test_what_a_job_left_belongs_to_the_service(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()

    def leave(folder: Path, _progress: ProgressCallback) -> bytes:
        (folder / "below").mkdir()
        (folder / "below" / "labels").write_text(str(os.getuid()))
        return b""

    sandbox = JobSandbox(folder, (), Said(Job(root_id="1" * 32)), make_settings(tmp_path), lambda: None)
    sandbox.run(leave, "stage", 1)
    assert {path.stat().st_uid for path in folder.rglob("*")} == {os.getuid()}
    assert int((folder / "below" / "labels").read_text()) >= os.getuid()
