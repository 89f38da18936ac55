"""A server as a child process: started until it responds, stopped or killed, started again on the same port.

**Conventions.** The kernel ends the child when the thread that started it dies (`PR_SET_PDEATHSIG`), so `kill -9` of a
test run leaves no server behind. Ports lie below the kernel's range for clients, so no connection takes one meanwhile.
"""

import ctypes
import os
import random
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

PATIENCE_S = 300.0
_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


def free_port() -> int:
    """Return a free port of 127.0.0.1."""
    chance = random.Random(os.urandom(8))
    while True:
        port = chance.randrange(15_000, 32_000)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


def answers(port: int, address: str = "127.0.0.1") -> bool:
    """Return whether the address accepts connections."""
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex((address, port)) == 0


@dataclass
class ServerProcess:
    """A server process with repeatable `start()`, `stop()`, `kill()`. `log` is its output."""

    command: Sequence[str | Path]
    folder: Path
    is_ready: Callable[[], bool]
    user: str | None = None
    stop_signal: signal.Signals = signal.SIGTERM
    environment: Mapping[str, str] = field(default_factory=dict)
    patience_s: float = PATIENCE_S
    _child: subprocess.Popen[bytes] | None = None

    @property
    def log(self) -> Path:
        return self.folder / "log"

    @property
    def pid(self) -> int:
        assert self._child is not None, "not started"
        return self._child.pid

    def start(self) -> None:
        """Start and wait until it responds. Raises `RuntimeError` with its last output if it ends instead."""
        with self.log.open("ab") as log:
            self._child = subprocess.Popen(
                [str(word) for word in self.command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self.folder,
                env={**os.environ, **self.environment},
                user=self.user,
                group=None if self.user is None else 65534,
                extra_groups=None if self.user is None else [],
                preexec_fn=lambda: _LIBC.prctl(_PR_SET_PDEATHSIG, self.stop_signal),
            )
        deadline_s = time.monotonic() + self.patience_s
        while not self.is_ready():
            if self._child.poll() is not None or time.monotonic() > deadline_s:
                self.kill()
                raise RuntimeError(f"{self.command[0]} did not start: {self.log.read_text()[-2000:]}")
            time.sleep(0.02)

    def stop(self) -> None:
        """Stop it and wait; kill it if it does not end."""
        self._end(self.stop_signal)

    def kill(self) -> None:
        """End it as in a power cut."""
        self._end(signal.SIGKILL)

    def _end(self, number: signal.Signals) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        child.send_signal(number)
        try:
            child.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
