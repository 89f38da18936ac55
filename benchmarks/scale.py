"""One sequence labelled by 1, 2 and 4 workers, measured and foretold: `python -m benchmarks.scale`.

Every run is a process of its own with a fresh embedded platform, its times read off the rows of its jobs. By the run
with one worker, and by how much runs slow each other down, a simulation foretells the others (`benchmarks/fleet`); the
table says what was foretold, what was measured, and how many cores others took meanwhile: on an idle machine that is
the platform's own small processes. All is kept as JSON; with `--keep` it becomes what `benchmarks.fleet` is fed with.
Ends with 1 when a forecast is off by more than 15 %.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.fleet.measuring import Measured, measured, measured_of, record_of
from benchmarks.fleet.predicting import WITHIN, Forecast, contention_of, forecast, middle
from services.runtime.atomic import atomic_file
from simulator.options import SimulateOptions
from simulator.pipeline import simulate

KEPT = Path(__file__).parent / "fleet" / "measured.json"
PATIENCE_S = 1800.0
TRIES = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long the robot drove")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--rounds", type=int, default=3, help="of each; the one in the middle counts")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    parser.add_argument("--json", type=Path, default=Path("build") / "scale.json")
    parser.add_argument("--keep", action="store_true", help=f"also as {KEPT.name}, for benchmarks.fleet")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--bag", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one is not None:
        _write(options.one, record_of(measured(options.bag, options.workers[0])))
        return
    bag = options.folder / f"scale-64x900-{options.seconds:g}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(options.seconds, channels=64, columns=900))
    found = _all_runs(bag, sorted({1, *options.workers}), options.rounds)
    record = _record(found, options.seconds)
    for path in (options.json, *((KEPT,) if options.keep else ())):
        _write(path, record)
    sys.exit(_show(record, options.json))


def _all_runs(bag: Path, workers: list[int], rounds: int) -> dict[str, list[Measured]]:
    """By number of workers, and `together`: strangers with one worker each, as many as there are cores."""
    found: dict[str, list[Measured]] = {}
    console = Console(stderr=True)
    for number in range(rounds):  # interleaved, so that an hour of load beside us is nobody's alone
        for count in workers:
            console.print(f"round {number + 1} of {rounds}: {count} worker(s)")
            found.setdefault(str(count), []).extend(_tried(bag, count, 1))
    cores = found["1"][0].cores
    console.print(f"{cores} runs with one worker each, at once")
    found["together"] = _tried(bag, 1, cores)
    return found


def _tried(bag: Path, workers: int, at_once: int) -> list[Measured]:
    """As `_measured_apart`, again where a platform did not come up: on a busy machine it may not in time."""
    for _ in range(TRIES - 1):
        try:
            return _measured_apart(bag, workers, at_once)
        except RuntimeError as error:
            Console(stderr=True).print(f"once more: {str(error).strip().splitlines()[-1]}", markup=False)
    return _measured_apart(bag, workers, at_once)


def _measured_apart(bag: Path, workers: int, at_once: int) -> list[Measured]:
    """Runs in processes of their own, begun together. Raises `RuntimeError` with the last words of one that failed."""
    with tempfile.TemporaryDirectory(dir=bag.parent) as folder:
        outputs = [Path(folder) / f"{number}.json" for number in range(at_once)]
        children = [_started(bag, workers, output) for output in outputs]
        for child in children:
            words, _ = child.communicate(timeout=PATIENCE_S)
            if child.returncode:
                raise RuntimeError(f"a run with {workers} worker(s) failed: {words.decode(errors='replace')[-2000:]}")
        return [measured_of(json.loads(output.read_text("utf-8"))) for output in outputs]


def _started(bag: Path, workers: int, output: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "benchmarks.scale", "--one", str(output), "--bag", str(bag)]
    return subprocess.Popen(
        [*command, "--workers", str(workers)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
    )


def _record(found: dict[str, list[Measured]], recorded_s: float) -> dict[str, Any]:
    base = middle(found["1"])
    contention = contention_of(found["1"], found["together"])
    counts = [count for count in found if count not in ("1", "together")]
    foretold = [forecast(base, contention, middle(found[count])) for count in counts]
    return {
        "recorded_s": recorded_s,
        "contention": contention,
        "base": record_of(base),
        "forecasts": [asdict(one) for one in foretold],
        "walls_s": {count: [round(run.wall_s, 3) for run in runs] for count, runs in found.items()},
        "taken": {count: [round(run.taken, 3) for run in runs] for count, runs in found.items()},
        "cpu_s": {count: [round(run.cpu_s, 3) for run in runs] for count, runs in found.items()},
    }


def _show(record: dict[str, Any], kept: Path) -> int:
    """Print what was measured and foretold; 1 when a forecast is too far off."""
    base = measured_of(record["base"])
    graph, console = base.graph(), Console()
    table = Table(title=f"{record['recorded_s']:g} s recorded, {base.frames} frames, {len(base.run)} jobs")
    for column in ("workers", "measured s", "all rounds s", "others took cores", "foretold s", "off by"):
        table.add_column(column, justify="right")
    table.add_row("1", f"{base.wall_s:.2f}", _listed(record["walls_s"]["1"]), f"{base.taken:.2f}", "", "")
    foretold = [Forecast(**one) for one in record["forecasts"]]
    for one in foretold:
        walls = _listed(record["walls_s"][str(one.workers)])
        cells = (f"{one.measured_s:.2f}", walls, f"{one.taken:.2f}", f"{one.predicted_s:.2f}", f"{one.error:+.1%}")
        table.add_row(str(one.workers), *cells)
    console.print(table)
    console.print(f"longest chain of needs {graph.critical_s:.2f} s of {graph.work_s:.2f} s of work")
    console.print(f"a job is {record['contention']:.3f} times as slow with every core busy; kept in {kept}")
    is_good = all(one.is_within for one in foretold)
    console.print(f"every forecast within {WITHIN:.0%}: {'yes' if is_good else 'NO'}")
    return 0 if is_good else 1


def _listed(values: list[float]) -> str:
    return " ".join(f"{value:.1f}" for value in values)


def _write(path: Path, record: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as partial:
        partial.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
