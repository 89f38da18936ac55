"""Pytest in a fork of a process that has loaded the libraries of others already: starting is most of a small run.

**Conventions.** Only what lies in `site-packages` is loaded before; every module of the tree is loaded anew by each
run, so none holds a fault of another. Nothing is computed with what is loaded: no library has threads yet.
"""

import contextlib
import importlib
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

LOADED_BY = (
    "api.main",
    "services.eval.tasks",
    "services.ingest.tasks",
    "services.labeler.tasks",
    "testing.servers.fixtures",
    "testing.web.browsing",
)
ASKED = """
import importlib, json, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
print(json.dumps([name for name, it in sys.modules.items() if "site-packages" in (getattr(it, "__file__", "") or "")]))
"""
BROKEN = 70  # pytest itself raised, as it does where a `conftest.py` cannot be loaded
NOT_BEFORE = ("_pytest.assertion", "playwright")  # pytest rewrites the one; the other starts what a fork would share


@dataclass
class Forked:
    """A child of this process; `output` is what it has said so far."""

    pid: int
    output: Path
    returncode: int | None = None

    def poll(self) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def said(self) -> str:
        return self.output.read_text("utf-8", "replace")


def preload(root: Path) -> None:
    """Load the libraries that the tree at `root` uses."""
    command = [sys.executable, "-c", ASKED, *LOADED_BY]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    told = subprocess.run(command, cwd=root, env=environment, check=True, capture_output=True, text=True).stdout
    names = [name for name in json.loads(told.splitlines()[-1]) if not name.startswith(NOT_BEFORE)]
    for name in names:
        with contextlib.suppress(Exception):  # what cannot be loaded alone is loaded by the run
            importlib.import_module(name)


def fork_pytest(root: Path, arguments: Sequence[str], environment: Mapping[str, str], output: Path) -> Forked:
    """Run pytest on the tree at `root`, in a session of its own."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        code = BROKEN
        try:
            code = _run(root, arguments, environment, output)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    return Forked(pid, output)


def _run(root: Path, arguments: Sequence[str], environment: Mapping[str, str], output: Path) -> int:
    os.setsid()
    written = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for number in (1, 2):
        os.dup2(written, number)
    sys.stdin, sys.stdout, sys.stderr = open(os.devnull), open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
    os.chdir(root)
    os.environ.clear()
    os.environ.update(environment)
    sys.pycache_prefix, sys.dont_write_bytecode = environment["PYTHONPYCACHEPREFIX"], False
    sys.path[:] = [str(root), *(path for path in sys.path if "site-packages" in path or "lib/python" in path)]
    sys.argv = ["pytest", *arguments]
    _forget_trees()
    numba, pytest = importlib.import_module("numba"), importlib.import_module("pytest")
    numba.config.CACHE_DIR = environment["NUMBA_CACHE_DIR"]
    code = int(pytest.main(list(arguments)))
    sys.stdout.flush()
    return code


def _forget_trees() -> None:
    """Modules of the project that this process itself runs on."""
    for name, module in list(sys.modules.items()):
        path = getattr(module, "__file__", None) or ""
        if name != "__main__" and path and "site-packages" not in path and "lib/python" not in path:
            del sys.modules[name]
    importlib.invalidate_caches()
