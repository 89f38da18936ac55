"""The API as a separate process, on a socket that outlives it: it can be killed and started again.

**Conventions.** While no process runs, connections wait in the socket's queue, as behind a supervisor.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from services.runtime.embedded.supervisor import environment_of
from services.runtime.settings import Settings

STARTS_WITHIN_S = 300.0


class ApiProcess:
    """`start`, `kill` (−9), `stop` (SIGTERM); `url` stays the same."""

    def __init__(self, settings: Settings, log: Path) -> None:
        self._settings, self._log = settings, log
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._process: subprocess.Popen[bytes] | None = None
        self.port: int = self._listening.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start, and wait until it responds."""
        descriptor = self._listening.fileno()
        command = [sys.executable, "-m", "services.runtime.embedded.api_process", str(descriptor), "2"]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                command, env=environment_of(self._settings), pass_fds=[descriptor], stdout=log, stderr=log
            )
        deadline = time.monotonic() + STARTS_WITHIN_S
        while not self._answers():
            assert self._process.poll() is None, self._log.read_text()[-2000:]
            assert time.monotonic() < deadline, self._log.read_text()[-2000:]

    def kill(self) -> None:
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def close(self) -> None:
        self._end(signal.SIGKILL)
        self._listening.close()

    def peak_bytes(self) -> int:
        """Return the peak memory of the process."""
        status = Path(f"/proc/{self.pid}/status").read_text("ascii")
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024

    def processor_s(self) -> float:
        """Return the user and system time of the process."""
        fields = Path(f"/proc/{self.pid}/stat").read_text("ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _answers(self) -> bool:
        try:
            return httpx.get(f"{self.url}/healthz", timeout=10).status_code == 200
        except httpx.TransportError:
            time.sleep(0.05)
            return False

    def _end(self, number: int) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait(STARTS_WITHIN_S)
            self._process = None


@contextmanager
def running_api(settings: Settings, log: Path) -> Iterator[ApiProcess]:
    process = ApiProcess(settings, log)
    try:
        process.start()
        yield process
    finally:
        process.close()
