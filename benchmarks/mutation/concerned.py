"""The tests that concern a module: test files by how near they are to it, the nearest first.

**Conventions.** Nearness is the number of imports from the test file to the module. A test outside the folder that
mirrors the module's counts as farther, one that is named after it as nearer. Browser, chaos and command tests are left
out: they reach everything and take minutes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.import_graph import ImportGraph, hops, module_name

FAR_HOPS = 5
ELSEWHERE, NAMESAKE = 1.5, -0.5
LEFT_OUT = ("tests/web", "tests/chaos", "tests/e2e", "tests/deploy", "tests/docsite", "tests/fuzz", "tests/benchmarks")


@dataclass(frozen=True)
class ClosestTests:
    """Test files of a tree, ready to be asked for the ones that concern a module."""

    root: Path
    graph: ImportGraph

    def tests_of(self, path: Path, most: int) -> Sequence[str]:
        """At most `most` test files, relative to the root, the nearest first."""
        module = module_name(self.root, path)
        reached = hops(self.graph.importers, module)
        rated = [
            (distance + self._kinship(path, self.graph.files[name]), test)
            for name, distance in reached.items()
            if distance <= FAR_HOPS and (test := self._test_file(name))
        ]
        return [test for _, test in sorted(rated)[:most]]

    def affected(self, path: Path) -> list[Path]:
        """The module and all that import it, however far: what may hold compiled code of it."""
        return [self.graph.files[name] for name in hops(self.graph.importers, module_name(self.root, path))]

    def _test_file(self, name: str) -> str | None:
        path = self.graph.files[name].relative_to(self.root)
        is_test = path.name.startswith("test_") and path.parts[0] == "tests"
        return str(path) if is_test and not str(path).startswith(LEFT_OUT) else None

    def _kinship(self, path: Path, test: Path) -> float:
        mirrored = self.root / "tests" / path.relative_to(self.root).parent
        words = set(path.stem.split("_")) & set(test.stem.split("_"))
        return (0.0 if test.is_relative_to(mirrored) else ELSEWHERE) + (NAMESAKE if words else 0.0)
