"""Failed tests run once more, each alone in a fresh process: `pytest --rerun-failed-once`.

**Conventions.** The second runs start when all other tests and the processes of `pytest-xdist` have ended. If at most
`MAX_RERUN` tests failed and all of them pass then, the run ends green, and its last lines are `flaky: <test id>`. If a
test fails again, or more tests failed, the run stays red. Reports of first failures are printed as usual.

Errors of collection, internal errors, interrupts and crashed workers stay red, and `-x` and `--maxfail` switch second
runs off. Plugins that rerun tests immediately do so under the load that made them fail, and count no failures.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import pytest

MAX_RERUN = 3
FLAKY = "build/flaky-tests"
"""Lines of all runs so far, below the root: `make check` runs pytest several times, and prints these last."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rerun-failed-once",
        action="store_true",
        help=f"run up to {MAX_RERUN} failed tests once more, each alone, and pass if all of them pass then",
    )


def pytest_configure(config: pytest.Config) -> None:
    is_worker = hasattr(config, "workerinput")
    if config.getoption("--rerun-failed-once") and not config.getoption("maxfail") and not is_worker:
        config.pluginmanager.register(Reruns(), "reruns-once")


@dataclass(eq=False)  # pytest stores plugins in sets
class Reruns:
    """A plugin that collects failed tests and runs them again at the end of the session."""

    _failed: dict[str, None] = field(default_factory=dict)  # ordered, each once
    _is_broken: bool = False

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._is_broken |= report.failed

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed[report.nodeid] = None

    @pytest.hookimpl(optionalhook=True)  # hook of pytest-xdist
    def pytest_testnodedown(self, error: object | None) -> None:
        self._is_broken |= error is not None

    @pytest.hookimpl(wrapper=True, tryfirst=True)  # around the reporter's hook, which prints the summary
    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> Iterator[None]:
        result = yield
        is_stopped = bool(session.shouldfail or session.shouldstop)
        if exitstatus == pytest.ExitCode.TESTS_FAILED and self._failed and not self._is_broken and not is_stopped:
            self._run_again(session)
        return result

    def _run_again(self, session: pytest.Session) -> None:
        terminal: pytest.TerminalReporter | None = session.config.pluginmanager.getplugin("terminalreporter")
        if terminal is None:  # `-p no:terminal`: nothing could say which tests are flaky
            return
        if len(self._failed) > MAX_RERUN:
            terminal.write_line(f"{len(self._failed)} tests failed, more than {MAX_RERUN}: none runs again")
            return
        terminal.section("failed tests once more, each alone")
        outputs = {test: failure_alone(session.config, test) for test in self._failed}
        for test, output in outputs.items():
            if output is not None:
                terminal.write_line(output)
                terminal.write_line(f"failed again: {test}")
        if all(output is None for output in outputs.values()):
            session.exitstatus = pytest.ExitCode.OK
        for flaky in [f"flaky: {test}" for test, output in outputs.items() if output is None]:
            terminal.write_line(flaky)
            note(session.config.rootpath / FLAKY, flaky)


def failure_alone(config: pytest.Config, test: str) -> str | None:
    """Run the test in a fresh process; return None if it passes, and otherwise what that process printed."""
    command = [sys.executable, "-m", "pytest", f"--rootdir={config.rootpath}"]
    command += [f"--config-file={config.inipath}"] if config.inipath else []
    command += [word for name in config.getoption("plugins") or () for word in ("-p", name)]
    command += [word for setting in config.getoption("override_ini") or () for word in ("-o", setting)]
    command += ["-n0"] if hasattr(config.option, "numprocesses") else []
    # The next `pytest --last-failed` runs the flaky test, too: this process leaves the cache alone.
    command += ["-p", "no:cacheprovider", test]
    # The options of this variable are in `config` already, and would make that process run its failures again.
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command.insert(3, f"--junitxml={report}")
        ended = subprocess.run(
            command, cwd=config.rootpath, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
        )
        is_passed = ended.returncode == 0 and has_one_passed(report)
    return None if is_passed else ended.stdout.decode("utf-8", "replace")


def note(path: Path, line: str) -> None:
    """Append the line to the file at `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def has_one_passed(report: Path) -> bool:
    """Return whether exactly one test ran and passed: a skipped test has not passed, nor one that ended its process."""
    if not report.exists():
        return False
    cases = list(ElementTree.parse(report).getroot().iter("testcase"))
    return len(cases) == 1 and not {child.tag for child in cases[0]} & {"failure", "error", "skipped"}
