"""Mutation testing, whether the tests notice small faults: `python -m benchmarks.mutation [FOLDER] [--draw MUTANTS]`.

`--draw` writes 200 random mutants of the tree at FOLDER (here) and runs nothing. `--run MUTANTS --into DIR` puts one
after another into a scratch copy below DIR, runs the test files that concern the module, nearest first, and keeps
`DIR/verdicts.json` up to date; begun again it goes on. `--map` (JSON, old path to new, files or folders) applies
mutants of another layout. `--again` tries those that survived once more, with larger limits. `--table` prints what DIR
holds.
"""

import argparse
import json
import signal
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.mutation.judging import Judge, Limits, Verdict
from benchmarks.mutation.mutants import Mutant, draw

PACKAGES: Mapping[str, tuple[Sequence[str], int]] = {
    "stone": (("stone",), 80),
    "jobs": (("services/runtime/jobs",), 30),
    "uploads": (("services/runtime/uploads",), 30),
    "scoring": (("services/eval", "services/domain/benchmarks"), 30),
    "access": (("services/runtime/access",), 30),
}
RESULTS = ("killed", "timeout", "survived", "lost")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path())
    parser.add_argument("--draw", type=Path, metavar="MUTANTS")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--run", type=Path, metavar="MUTANTS")
    parser.add_argument("--map", type=Path, help="where the mutants' files are in this tree")
    parser.add_argument("--into", type=Path, default=Path("build") / "mutation", metavar="DIR")
    parser.add_argument("--cpu-s", type=float, default=60.0, help="processor seconds of tests for one mutant")
    parser.add_argument("--files", type=int, default=6, help="test files for one mutant")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    root = options.folder.resolve()
    if options.draw:
        drawn = draw(root, PACKAGES, options.seed)
        options.draw.write_text(json.dumps([asdict(one) for one in drawn], indent=1) + "\n", "utf-8")
    if options.run:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it, pytest's too then
        signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by SIGTERM; begun again it goes on"))
        mutants = [Mutant(**one) for one in json.loads(options.run.read_text("utf-8"))]
        moved = json.loads(options.map.read_text("utf-8")) if options.map else {}
        judge = Judge(root, options.into.resolve(), Limits(options.cpu_s, options.files))
        judge.run(mutants, moved, options.again)
    if options.run or options.table:
        show(json.loads((options.into / "verdicts.json").read_text("utf-8")))


def show(record: Mapping[str, Any]) -> None:
    """The table by package, and what survived."""
    verdicts = [Verdict(**one) for one in record["verdicts"]]
    console = Console(width=160)
    console.print(table_of(verdicts))
    for one in verdicts:
        if one.result in ("survived", "lost"):
            was, now = (" ".join(text.split()) for text in (one.mutant["original"], one.mutant["mutated"]))
            console.print(f"{one.result}: {one.where} {one.mutant['function']}: {one.mutant['operator']}", markup=False)
            console.print(f"    - {was}\n    + {now}", markup=False, highlight=False)


def table_of(verdicts: Sequence[Verdict]) -> Table:
    table = Table("package", "mutants", *RESULTS, "killed share", title="Mutants")
    packages = list(dict.fromkeys(one.mutant["package"] for one in verdicts))
    for package in (*packages, "all"):
        counts = Counter(one.result for one in verdicts if package in (one.mutant["package"], "all"))
        table.add_row(
            package, str(counts.total()), *(str(counts[one]) for one in RESULTS), f"{killed_share(counts):.1%}"
        )
    return table


def killed_share(counts: Mapping[str, int]) -> float:
    """Of those that were in the tree; one that ran out of time was noticed too."""
    noticed = counts.get("killed", 0) + counts.get("timeout", 0)
    tried = noticed + counts.get("survived", 0)
    return noticed / tried if tried else 0.0


if __name__ == "__main__":
    main()
