"""A sandboxed child ends with whoever waits for it, and works where the platform calls it: in a prefork worker."""

import os
import signal
import subprocess
import sys
import time

import pytest

from testing.process_states import is_running

PARENT = """
import os, sys, time
from services.runtime.sandbox import sandboxed
from services.runtime.telemetry.log_lines import speak_json
speak_json()  # to stderr
def work():
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(600)
sandboxed(work)
"""
# What Celery's prefork pool does: a daemonic billiard process with threads beside the task.
WORKER = """
import threading, time
import billiard
from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.sandbox.errors import SandboxCrashedError
import os
def task(answers):
    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    answers.put(sandboxed(lambda: b"answered"))
    try:
        sandboxed(lambda: os.abort(), SandboxLimits(cpu_s=1))
    except SandboxCrashedError as error:
        answers.put(str(error))
if __name__ == "__main__":
    context = billiard.get_context("fork")
    answers = context.SimpleQueue()
    process = context.Process(target=task, args=(answers,), daemon=True)
    process.start()
    print(answers.get(), answers.get())
    process.join()
"""


@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGTERM])
def test_the_child_of_a_killed_parent_ends_with_it(death: int) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_running(child)
        os.kill(parent.pid, death)
        parent.wait(300)
        for _ in range(1200):
            if not is_running(child):
                break
            time.sleep(0.05)
        assert not is_running(child)


def test_a_prefork_worker_may_confine() -> None:
    run = subprocess.run([sys.executable, "-c", WORKER], capture_output=True, text=True, timeout=300)
    assert "b'answered'" in run.stdout, run.stderr
    assert "was ended by SIGABRT" in run.stdout
