"""Fuzz parsers and labelling: `python -m fuzz [--minutes 10] [--only mcap db3 messages labels …] [--folder DIR]`.

`--minutes` applies to each target; two run in parallel. The exit code is 1 if an input crashed a parser, took it ten
seconds or cost it more than 64 MiB. Labelling, whose kernels check their indices here, may take a minute and 512 MiB.
The folder contains such inputs. After the repair, move the input to `tests/fuzz/cases/<target>/`, where every test run
plays it again.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from fuzz.limits import FuzzLimits
from fuzz.seeds import write_seeds
from fuzz.targets import TARGETS, limits_of

ROOT = Path(__file__).resolve().parents[1]
CASES = ROOT / "tests" / "fuzz" / "cases"
SHORT_BYTES = 1 << 12
PROGRESS = re.compile(r"^#(\d+)\s.*?cov: (\d+) ft: (\d+)", re.MULTILINE)
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


@dataclass(frozen=True)
class FuzzResult:
    """The results of a target: inputs tried, branches reached, the inputs that broke it."""

    name: str
    inputs: int
    branches: int
    broken: tuple[Path, ...]
    exit_code: int


def main() -> int:
    options = _options()
    CONSOLE.print(f"seed {options.seed}, folder {options.folder}")
    with ThreadPoolExecutor(options.jobs) as pool:
        fuzzed = list(pool.map(lambda name: _fuzz(name, options), options.only or TARGETS))
    CONSOLE.print(_table(fuzzed, options))
    for result in fuzzed:
        for path in result.broken:
            CONSOLE.print(f"{result.name}: {path}; see {options.folder / result.name}.log")
    return 1 if any(result.broken or result.exit_code for result in fuzzed) else 0


def _fuzz(name: str, options: argparse.Namespace) -> FuzzResult:
    folder: Path = options.folder / name
    corpus, crashes = folder / "corpus", folder / "found"
    for each in (corpus, crashes):
        each.mkdir(parents=True, exist_ok=True)
    write_seeds(name, corpus)
    may = limits_of(name)
    limits = [
        f"-max_total_time={int(options.minutes * 60)}",
        f"-timeout={may.hang_s}",
        f"-rss_limit_mb={may.process_mb}",
    ]
    shape = [
        f"-max_len={may.longest_bytes}",
        f"-seed={options.seed}",
        f"-artifact_prefix={crashes}/",
        "-print_final_stats=1",
        f"-report_slow_units={may.hang_s}",
        *(["-len_control=0"] if may.longest_bytes < SHORT_BYTES else []),
    ]
    known = [str(CASES / name)] if (CASES / name).is_dir() else []
    command = [sys.executable, "-m", "fuzz.libfuzzer", name, *limits, *shape, str(corpus), *known]
    log = options.folder / f"{name}.log"
    with log.open("wb") as file:
        ended = subprocess.run(command, cwd=ROOT, env=_environment(options, folder, may), stdout=file, stderr=file)
    rows = PROGRESS.findall(log.read_text("utf-8", "replace")) or [("0", "0", "0")]
    return FuzzResult(name, int(rows[-1][0]), int(rows[-1][2]), tuple(sorted(crashes.iterdir())), ended.returncode)


def _environment(options: argparse.Namespace, folder: Path, may: FuzzLimits) -> dict[str, str]:
    """Return the environment; checked kernels have a cache of their own, since numba mixes them with unchecked."""
    checked = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder / "kernels")} if may.is_checked else {}
    return {**os.environ, "TMPDIR": options.scratch, **checked}


def _table(fuzzed: list[FuzzResult], options: argparse.Namespace) -> Table:
    table = Table(title=f"{options.minutes:g} minutes each, seed {options.seed}")
    for column in ("target", "inputs", "branches met", "crashes, hangs, growth beyond the limit"):
        table.add_column(column, justify="left" if column == "target" else "right")
    for result in fuzzed:
        table.add_row(result.name, str(result.inputs), str(result.branches), str(len(result.broken)))
    return table


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="of each target")
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), default=[])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="number of parallel targets")
    parser.add_argument("--folder", type=Path, help="folder of the inputs (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-fuzz-"))).absolute()
    options.folder.mkdir(parents=True, exist_ok=True)
    memory = Path("/dev/shm")  # input files are short-lived; on a disk, writing them takes longest
    options.scratch = str(memory) if memory.is_dir() else tempfile.gettempdir()
    return options


if __name__ == "__main__":
    sys.exit(main())
