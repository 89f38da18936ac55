"""The database cost of a job, and the workers per database: `python -m benchmarks.rows.claiming COMMAND`.

`count` labels a simulated recording on a real platform (PostgreSQL, Redis, API, sweeper, workers) and reads the
workers' requests from PostgreSQL's log: transactions and statements per job, by purpose. The processor time comes from
another recording without logging. `share` runs many processes that claim empty jobs from one database. `foretell`
simulates hundreds of workers with both results, on a database with `--cores` of its own, and prints the number beyond
which more workers have no effect.
"""

import argparse
import json
import os
import tempfile
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.rows.claiming.counting import RunCost, counted, recording
from benchmarks.rows.claiming.forecast import WorkerFleet, carried, demand_of, pace, transaction_s
from benchmarks.rows.claiming.sharing import shared
from services.runtime.settings import JobSettings

CONSOLE = Console(width=110)
WARM_UP_S = 50.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    count = commands.add_parser("count", help="transactions and statements a job")
    count.add_argument("--seconds", type=float, default=60.0, help="of recording")
    count.add_argument("--workers", type=int, default=2, help="worker processes")
    count.add_argument("--idle-s", type=float, default=20.0, help="duration of the idle measurement, seconds")
    count.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    count.add_argument("--json", type=Path, default=Path("build") / "claiming-count.json")
    count.set_defaults(act=_count)
    share = commands.add_parser("share", help="throughput of many claiming processes on one database")
    share.add_argument("--processes", type=int, default=200)
    share.add_argument("--seconds", type=float, default=30.0)
    share.add_argument("--runs", type=int, default=500, help="number of waiting runs of 40 jobs")
    share.add_argument("--json", type=Path, default=Path("build") / "claiming-share.json")
    share.set_defaults(act=_share)
    foretell = commands.add_parser("foretell", help="simulate the number of workers per database")
    foretell.add_argument("--count", type=Path, default=Path("build") / "claiming-count.json")
    foretell.add_argument("--share", type=Path, default=Path("build") / "claiming-share.json")
    foretell.add_argument("--cores", type=int, default=2, help="of the database")
    foretell.add_argument("--workers", type=int, nargs="+", default=[1, 10, 50, 100, 200, 300, 500, 1000])
    foretell.add_argument("--shared", type=int, default=16, help="worker processes per keeper (1: no sharing)")
    foretell.set_defaults(act=_foretell)
    options = parser.parse_args()
    options.act(options)


def _count(options: argparse.Namespace) -> None:
    lengths = (WARM_UP_S, options.seconds, options.seconds + 1.0)  # a recording can be labelled only once
    bags = [recording(options.folder, seconds) for seconds in lengths]
    cost = counted(bags, options.workers, options.idle_s)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(asdict(cost), indent=1) + "\n", "utf-8")
    _show_count(cost)


def _share(options: argparse.Namespace) -> None:
    result = shared(options.processes, options.seconds, options.runs)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(asdict(result), indent=1) + "\n", "utf-8")
    figures = {
        "jobs/s": result.jobs / result.lasted_s,
        "transactions/s": result.transactions / result.lasted_s,
        "transactions a job": result.transactions / max(result.jobs, 1),
        "ms of PostgreSQL's processor time a job": 1e3 * result.database_cpu_s / max(result.jobs, 1),
    }
    CONSOLE.print(f"{result.processes} processes for {result.lasted_s:.1f} s, load average {os.getloadavg()[0]:.1f}")
    for name, figure in figures.items():
        CONSOLE.print(f"{figure:10.2f} {name}")


def _foretell(options: argparse.Namespace) -> None:
    cost, share = (json.loads(path.read_text("utf-8")) for path in (options.count, options.share))
    demand, each_s = demand_of(cost, is_shared=options.shared > 1), transaction_s(cost, share)
    turn_s = JobSettings().progress_s
    fleets = [WorkerFleet(workers, options.shared, turn_s, options.cores, each_s) for workers in options.workers]
    paces = [pace(demand, fleet) for fleet in fleets]
    of_database = f"{options.cores} cores at {1e3 * each_s:.2f} ms a transaction"
    table = Table(title=f"a database of {of_database}; jobs of {sum(demand.job_s) / len(demand.job_s):.2f} s")
    for column in ("workers", "jobs per second", "runs an hour", "in jobs", "database"):
        table.add_column(column, justify="right")
    for rate in paces:
        runs = rate.jobs_per_s * 3600 / len(demand.job_s)
        row = (
            f"{rate.workers:,}",
            f"{rate.jobs_per_s:.1f}",
            f"{runs:,.0f}",
            f"{rate.busy:.0%}",
            f"{rate.database:.0%}",
        )
        table.add_row(*row)
    CONSOLE.print(table)
    CONSOLE.print(f"all of them do what {carried(paces):.0f} workers would at the pace of {paces[0].workers}")


def _show_count(cost: RunCost) -> None:
    title = (
        f"{cost.jobs} jobs of {sum(cost.job_s):.1f} s, {cost.run.lasted_s:.1f} s with {cost.run.processes} processes"
    )
    table = Table(title=f"{title}, load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for column in ("what for", "transactions a job", "statements a job", "transactions/s of an idle process"):
        table.add_column(column, justify="left" if column == "what for" else "right")
    for purpose, times in sorted(cost.run.transactions.items(), key=lambda item: -item[1]):
        idle = cost.idle.transactions.get(purpose, 0) / cost.idle.lasted_s / cost.idle.processes
        per_job = (times / cost.jobs, cost.run.statements[purpose] / cost.jobs, idle)
        table.add_row(purpose, *(f"{figure:.2f}" for figure in per_job))
    whole = (sum(cost.run.transactions.values()) / cost.jobs, sum(cost.run.statements.values()) / cost.jobs)
    table.add_row("all", *(f"{figure:.2f}" for figure in (*whole, cost.idle.transactions_per_s())))
    CONSOLE.print(table)
    CONSOLE.print(f"{1e3 * cost.cpu_s_a_job:.2f} ms of PostgreSQL's processor time a job for the workers")


if __name__ == "__main__":
    main()
