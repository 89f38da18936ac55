"""One test many times beside load: `make stress TEST=tests/api/test_events.py::test_a_job_is_followed_to_its_end`.

**Conventions.** All runs are in one pytest process, so that its start is paid once: a run shares the fixtures of its
module and session with the others. Two busy loops per core run beside them. The program prints the report of the first
failure and how many runs failed. It exits with 1 if a run failed, and with pytest's own code if pytest could not run
the test.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

LOOPS_PER_CORE = 2
# Each loop ends with this process, even if that is killed.
BUSY = "import os, sys\nwhile os.getppid() == int(sys.argv[1]):\n    pass"


@dataclass(eq=False)  # pytest stores plugins in sets
class Stress:
    """A plugin that repeats the collected tests `runs` times, beside load."""

    runs: int
    failed_runs: set[int] = field(default_factory=set)
    skipped_runs: set[int] = field(default_factory=set)
    first_failure: str = ""
    _run_of: dict[pytest.Item, int] = field(default_factory=dict)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        self._run_of = {_again(item): run for run in range(self.runs) for item in items}
        items[:] = self._run_of

    @pytest.hookimpl(wrapper=True)
    def pytest_runtestloop(self) -> Iterator[None]:
        with load(LOOPS_PER_CORE * (os.cpu_count() or 1)):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[None]:
        report: pytest.TestReport = yield  # type: ignore[assignment]
        if report.skipped:
            self.skipped_runs.add(self._run_of[item])
        if report.failed:
            self.failed_runs.add(self._run_of[item])
            sections = "".join(f"\n--- {title} ---\n{text}" for title, text in report.sections)
            self.first_failure = self.first_failure or f"{report.nodeid}\n{report.longreprtext}{sections}\n"
        return report  # type: ignore[return-value]


def _again(item: pytest.Item) -> pytest.Item:
    """Return a new item of the same test: its fixtures, instance and captured output are created again."""
    if not isinstance(item, pytest.Function):
        raise pytest.UsageError(f"{item.nodeid} is no test function")
    again: pytest.Item = type(item).from_parent(
        item.parent,
        name=item.name,
        originalname=item.originalname,
        callspec=getattr(item, "callspec", None),
        fixtureinfo=item._fixtureinfo,
        keywords=item.keywords,
    )
    return again


@contextmanager
def load(loops: int) -> Iterator[None]:
    """Keep `loops` processes busy while the block runs."""
    command = [sys.executable, "-S", "-c", BUSY, str(os.getpid())]
    busy = [subprocess.Popen(command) for _ in range(loops)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def stress(test: str, runs: int) -> int:
    """Run the test `runs` times, print the result, and return the exit code."""
    plugin = Stress(runs)
    code = pytest.main(["-q", "--no-summary", "-p", "no:cacheprovider", test], [plugin])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        return int(code)
    skipped = f", {len(plugin.skipped_runs)} skipped" if plugin.skipped_runs else ""
    sys.stdout.write(f"\n{plugin.first_failure}{len(plugin.failed_runs)} of {runs} failed{skipped}\n")
    return 1 if plugin.failed_runs else int(code)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Run one test many times beside two busy loops per core.")
    parser.add_argument("test", help="node id or file, as pytest takes it")
    parser.add_argument("--runs", type=int, default=50, help="how often (default: %(default)s)")
    arguments = parser.parse_args()
    sys.exit(stress(arguments.test, arguments.runs))
