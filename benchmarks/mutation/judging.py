"""The verdicts on mutants: each is put into the scratch copy and shown to the tests that concern it.

**Conventions.** A mutant is killed by the first failing test, if that passes without the fault, and fails once more
with it where the machine is busy. It timed out where a test file takes far more than on the sound tree, and has
survived when every file passed that the limits allow. The order is by chance: the first mutants are a sample.
"""

import json
import os
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.import_graph import read_import_graph, source_files
from benchmarks.mutation.concerned import ClosestTests
from benchmarks.mutation.forking import preload
from benchmarks.mutation.mutants import Located, Mutant, locate, read_source
from benchmarks.mutation.pytest_run import TestRun, run_tests
from benchmarks.mutation.scratch import Scratch, copy_tree

SOUND_LIMIT_S = 300.0
SLOWER, AT_LEAST_S = 4.0, 30.0
FIRST_BATCH = 3
BUSY_LOAD = 2.0  # processes that wait for each core


@dataclass(frozen=True)
class Limits:
    """For one mutant: processor seconds of tests, and test files."""

    cpu_s: float
    files: int


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant: killed, timeout, survived or lost; by which test, and which files were run."""

    mutant: Mapping[str, Any]
    result: str
    where: str
    by: str = ""
    cpu_s: float = 0.0
    tests: Sequence[str] = ()


@dataclass(frozen=True)
class Trial:
    """One mutant in the scratch copy: its number, its place, and the modules that its fault may be compiled into."""

    scratch: Scratch
    number: int
    located: Located
    affected: Sequence[Path]

    def run(self, tests: Sequence[str], limit_s: float) -> TestRun:
        with self.scratch.faulty(self.located, self.number, self.affected):
            return run_tests(self.scratch.root, tests, limit_s, self.scratch.cache)


@dataclass(frozen=True)
class Judge:
    """A tree and the folder in which its mutants are tried; what was found out so far is kept there.

    `sound` is how tests and test files go without any fault.
    """

    root: Path
    folder: Path
    limits: Limits
    sound: dict[str, TestRun] = field(default_factory=dict)

    def run(self, mutants: Sequence[Mutant], moved: Mapping[str, str], is_again: bool) -> None:
        """Every mutant that has no verdict yet; those that survived too, where it is done again."""
        verdicts = self._read()
        scratch = copy_tree(self.root, self.folder)
        preload(scratch.root)
        nearest = ClosestTests(scratch.root, read_import_graph(scratch.root))
        sources = {path: read_source(path) for path in source_files(scratch.root)}
        for number in random.Random(0).sample(range(len(mutants)), len(mutants)):
            known = verdicts.get(number)
            if known and not (is_again and known.result == "survived"):
                continue
            mutant = mutants[number]
            located = locate(mutant, scratch.root, moved, sources)
            if located is None:
                verdicts[number] = Verdict(asdict(mutant), "lost", f"{mutant.file}:{mutant.line}")
            else:
                trial = Trial(scratch, number, located, nearest.affected(located.path))
                verdicts[number] = self._judge(mutant, trial, nearest.tests_of(located.path, self.limits.files))
            self._keep(verdicts, len(mutants))

    def _judge(self, mutant: Mutant, trial: Trial, tests: Sequence[str]) -> Verdict:
        where = f"{trial.located.path.relative_to(trial.scratch.root)}:{trial.located.line}"
        spent_s, ran = 0.0, list[str]()
        for batch in in_batches(tests):
            if spent_s >= self.limits.cpu_s:
                break
            run = trial.run(batch, max(self.limits.cpu_s - spent_s, AT_LEAST_S))
            spent_s, ran = round(spent_s + run.cpu_s, 1), [*ran, *batch]
            if result := self._result(batch, run, trial):
                by = run.failed or f"{' '.join(batch)} {run.outcome}"
                return Verdict(asdict(mutant), result, where, by, spent_s, ran)
        return Verdict(asdict(mutant), "survived", where, "", spent_s, ran)

    def _result(self, tests: Sequence[str], run: TestRun, trial: Trial) -> str | None:
        """What a run says of the mutant; nothing where it passed, or where it would not have without the fault."""
        if run.outcome == "failed":
            failed = [run.failed] if "::" in run.failed else tests
            is_sure = self._sound(failed, trial.scratch).outcome == "passed" and (
                not _is_busy() or trial.run(failed, SOUND_LIMIT_S).outcome != "passed"
            )
            return "killed" if is_sure else None
        if run.outcome == "passed":
            return None
        sound = self._sound(tests, trial.scratch)
        is_slower = run.outcome == "stood still" or run.cpu_s > max(SLOWER * sound.cpu_s, AT_LEAST_S)
        return "timeout" if sound.outcome == "passed" and is_slower else None

    def _sound(self, tests: Sequence[str], scratch: Scratch) -> TestRun:
        """A test or test files without the fault, tried twice before they are said to fail."""
        name = " ".join(tests)
        for _ in range(2):
            if name not in self.sound or self.sound[name].outcome != "passed":
                self.sound[name] = run_tests(scratch.root, tests, SOUND_LIMIT_S, scratch.cache)
        return self.sound[name]

    def _read(self) -> dict[int, Verdict]:
        path = self.folder / "verdicts.json"
        if not path.exists():
            return {}
        record = json.loads(path.read_text("utf-8"))
        self.sound.update({name: TestRun(**run) for name, run in record["sound"].items()})
        return {number: Verdict(**one) for number, one in zip(record["numbers"], record["verdicts"], strict=True)}

    def _keep(self, verdicts: Mapping[int, Verdict], asked: int) -> None:
        numbers = sorted(verdicts)
        record = {
            "asked": asked,
            "limits": asdict(self.limits),
            "numbers": numbers,
            "verdicts": [asdict(verdicts[number]) for number in numbers],
            "sound": {name: asdict(run) for name, run in self.sound.items()},
        }
        written = self.folder / "verdicts.json.new"
        written.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        os.replace(written, self.folder / "verdicts.json")


def in_batches(tests: Sequence[str]) -> Iterator[Sequence[str]]:
    """The files in their order: the first few, then twice as many, and so on."""
    begin, size = 0, FIRST_BATCH
    while begin < len(tests):
        yield tests[begin : begin + size]
        begin, size = begin + size, 2 * size


def _is_busy() -> bool:
    return os.getloadavg()[0] > BUSY_LOAD * (os.cpu_count() or 1)
