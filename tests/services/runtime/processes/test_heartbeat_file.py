"""Whether processes live is told by files, each by its own process alone."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from services.runtime.platform import Platform
from services.runtime.processes.health_check import FOLDER, HeartbeatFile, live_processes, refusal, silence
from testing.api.serving import serving

HOUR_S = 3600.0
BEATING = "import sys; from pathlib import Path; from services.runtime.processes.health_check import HeartbeatFile; "
BEATING += "HeartbeatFile(Path(sys.argv[1])).beat(); print('beat', flush=True); sys.stdin.read()"


def probe(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The image's health check."""
    command = [sys.executable, "-m", "services.runtime.processes.health_check", *arguments]
    environment = {**os.environ, "STONE_DATA_FOLDER": str(root)}
    return subprocess.run(command, check=False, capture_output=True, text=True, env=environment, timeout=300)


def ages(root: Path) -> None:
    """An hour passes."""
    for path in (root / FOLDER).iterdir():
        before_s = path.stat().st_mtime - HOUR_S
        os.utime(path, (before_s, before_s))


def test_a_process_that_beats_is_heard_until_it_stops(tmp_path: Path) -> None:
    pulse = HeartbeatFile(tmp_path)
    assert live_processes(tmp_path) == []
    pulse.beat()
    (one,) = live_processes(tmp_path)
    assert one.pid == os.getpid()
    assert one.age_s < HOUR_S
    pulse.stop()
    assert live_processes(tmp_path) == []


def test_what_a_killed_process_left_is_not_missed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", BEATING, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"beat\n"
        assert [one.pid for one in live_processes(tmp_path)] == [child.pid]
        child.kill()
    assert live_processes(tmp_path) == []
    assert list((tmp_path / FOLDER).iterdir()) == []


def test_neither_another_container_nor_a_pid_that_came_round_again_is_mistaken_for_ours(tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    other = tmp_path / FOLDER / f"other.{os.getpid()}.1"
    before_us = tmp_path / FOLDER / f"{socket.gethostname()}.{os.getpid()}.1"
    other.touch()
    before_us.touch()
    assert live_processes(tmp_path) == []
    assert (other.exists(), before_us.exists()) == (True, False)


def test_a_disk_that_is_gone_ends_nobody(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    pulse = HeartbeatFile(tmp_path / "file")
    pulse.beat()
    pulse.stop()


def test_the_verdict_names_who_is_late(tmp_path: Path) -> None:
    assert silence([], 60.0) != ""
    HeartbeatFile(tmp_path).beat()
    assert silence(live_processes(tmp_path), HOUR_S) == ""
    ages(tmp_path)
    assert silence(live_processes(tmp_path), 60.0).startswith(f"process {os.getpid()}: ")


def test_a_server_is_well_while_it_answers_with_success(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    with serving(platform) as url:
        assert refusal(f"{url}/healthz") == ""
        assert "404" in refusal(f"{url}/nowhere")
    assert "refused" in refusal(f"{url}/healthz")


@pytest.mark.parametrize(("arguments", "code"), [((), 1), (("7200",), 0)])
def test_the_probe_is_of_processes_of_this_machine(tmp_path: Path, arguments: tuple[str, ...], code: int) -> None:
    HeartbeatFile(tmp_path).beat()
    ages(tmp_path)
    outcome = probe(tmp_path, *arguments)
    assert outcome.returncode == code
    assert ("beat" in outcome.stderr) == bool(code)
