"""Ten, a hundred, a thousand workers, foretold: `python -m benchmarks.fleet [--pictures docs/images]`.

Fed with what `benchmarks.scale --keep`, `benchmarks.job_costs --keep` and `benchmarks.rows.claiming --keep` measured.
Machines, line and prices are assumptions, each an option.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.fleet.graph import Graph
from benchmarks.fleet.growing import Step, grown
from benchmarks.fleet.measuring import measured_of
from benchmarks.fleet.pictures import draw_forecasts, draw_growth
from benchmarks.fleet.predicting import Forecast
from benchmarks.fleet.pricing import Cost, Prices, cost_of
from benchmarks.fleet.sharing import Cores, Line
from benchmarks.fleet.simulation import Database, Fleet

HERE = Path(__file__).parent
FACTS = {"measured": "benchmarks.scale", "costs": "benchmarks.job_costs", "database": "benchmarks.rows.claiming"}
COUNTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 4000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--each", type=int, default=4, help="sequences for every worker")
    parser.add_argument("--per-machine", type=int, default=16, help="workers on a machine of as many cores")
    parser.add_argument("--store-gb-s", type=float, default=10.0, help="what the store gives and takes in all")
    parser.add_argument("--link-gb-s", type=float, default=0.15, help="what one worker gets and gives at most")
    parser.add_argument("--database-factor", type=float, default=1.0, help="of the transactions a second measured here")
    parser.add_argument("--order", choices=["run", "job"], default="run")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--json", type=Path, default=Path("build") / "fleet.json")
    options = parser.parse_args()
    measured, costs, database = (_fact(name, command) for name, command in FACTS.items())
    graph = fed(measured, costs)
    steps = list(grown(graph, fleet_of(measured, database, options), options.workers, options.each))
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps([asdict(one) for one in steps], indent=1) + "\n", "utf-8")
    _show(steps, graph, kept_bytes_per_frame(costs))
    if options.pictures:
        draw_growth(steps, options.pictures / "scale-workers.png")
        foretold = [Forecast(**one) for one in measured["forecasts"]]
        draw_forecasts(measured_of(measured["base"]).wall_s, foretold, options.pictures / "scale-forecasts.png")


def _fact(name: str, command: str) -> dict[str, Any]:
    path = HERE / f"{name}.json"
    if not path.exists():
        raise SystemExit(f"{path.name} is missing: run `python -m {command} --keep` first")
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def fed(measured: dict[str, Any], costs: dict[str, Any]) -> Graph:
    """The whole sequence as measured, with what each kind of job asks of database and store."""
    return measured_of(measured["base"]).graph(is_whole=True).asking(costs["kinds"])


def fleet_of(measured: dict[str, Any], database: dict[str, Any], options: argparse.Namespace) -> Fleet:
    """One worker; the machines have a core for each of theirs, all busy at once."""
    cores = Cores(options.per_machine, measured["contention"])
    rate_hz = transactions_hz(database) * options.database_factor
    servers = 8
    return Fleet(
        workers=1,
        per_machine=options.per_machine,
        cores=cores,
        dispatch_s=measured_of(measured["base"]).dispatch_s,
        database=Database(servers, servers / rate_hz),
        line=Line(options.store_gb_s * 1e9, options.link_gb_s * 1e9),
        order=options.order,
    )


def transactions_hz(database: dict[str, Any]) -> float:
    """The most that was measured; a job that is claimed and ended is two."""
    return max(2.0 * float(one["jobs_per_s"]) for one in database["taken"])


def kept_bytes_per_frame(costs: dict[str, Any]) -> float:
    """Recording, labels and playback."""
    kept = sum(costs[name] for name in ("recording_bytes", "labels_bytes", "playback_bytes"))
    return float(kept) / float(costs["frames"])


def _show(steps: list[Step], graph: Graph, kept_bytes: float) -> None:
    console = Console(width=170)
    console.print(f"a sequence: {len(graph.jobs)} jobs, {graph.frames} frames, {graph.cpu_s:.1f} CPU s,")
    console.print(f"{graph.work_s:.1f} s of work, longest chain {graph.critical_s:.1f} s")
    table = Table()
    for column in ("workers", "sequences/h", "frames/s", "busy", "job waits s p50/p95", "labelled after s p50/p95",
                   "open at once", "tx/s", "GB/s", "database", "line", "1e6 take days", "$/1,000 frames"):  # fmt: skip
        table.add_column(column, justify="right")
    for one in steps:
        cost = cost_of(one.frames_per_s, one.workers, kept_bytes, Prices())
        table.add_row(
            f"{one.workers:,}", f"{one.sequences_per_h:,.0f}", f"{one.frames_per_s:,.0f}", f"{one.efficiency:.0%}",
            _pair(one.ages_s), _pair(one.labelled_s), str(one.most_open), f"{one.transactions_per_s:,.1f}",
            f"{one.bytes_per_s / 1e9:.3f}", f"{one.database_ratio:.0%}", f"{one.line_ratio:.0%}",
            f"{one.million_days():,.1f}", _dollars(cost),
        )  # fmt: skip
    console.print(table)
    console.print("cost: workers + servers + a year of what is kept (recordings included)")


def _dollars(cost: Cost) -> str:
    return f"{cost.total:.4f} ({cost.workers:.4f} + {cost.servers:.4f} + {cost.kept:.4f})"


def _pair(values: tuple[float, float]) -> str:
    return f"{values[0]:.1f}/{values[1]:.1f}"


if __name__ == "__main__":
    main()
