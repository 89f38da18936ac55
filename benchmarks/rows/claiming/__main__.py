"""What a job costs the database: `python -m benchmarks.rows.claiming count`.

`count` labels a simulated recording on a real platform (PostgreSQL, Redis, API, sweeper, workers) and reads from
PostgreSQL's log what the workers asked for: transactions and statements a job, by what they were for.
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

CONSOLE = Console(width=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    count = commands.add_parser("count", help="transactions and statements a job")
    count.add_argument("--seconds", type=float, default=20.0, help="of recording")
    count.add_argument("--workers", type=int, default=2, help="worker processes")
    count.add_argument("--idle-s", type=float, default=20.0, help="how long they are watched while idle")
    count.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    count.add_argument("--json", type=Path, default=Path("build") / "claiming-count.json")
    count.set_defaults(act=_count)
    options = parser.parse_args()
    options.act(options)


def _count(options: argparse.Namespace) -> None:
    cost = counted(recording(options.folder, options.seconds), options.workers, options.idle_s)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(asdict(cost), indent=1) + "\n", "utf-8")
    _show_count(cost)


def _show_count(cost: RunCost) -> None:
    title = (
        f"{cost.jobs} jobs of {sum(cost.job_s):.1f} s, {cost.run.lasted_s:.1f} s with {cost.run.processes} processes"
    )
    table = Table(title=f"{title}, load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for column in ("what for", "transactions a job", "statements a job", "transactions/s of an idle process"):
        table.add_column(column, justify="left" if column == "what for" else "right")
    for purpose, times in sorted(cost.run.transactions.items(), key=lambda one: -one[1]):
        idle = cost.idle.transactions.get(purpose, 0) / cost.idle.lasted_s / cost.idle.processes
        per_job = (times / cost.jobs, cost.run.statements[purpose] / cost.jobs, idle)
        table.add_row(purpose, *(f"{figure:.2f}" for figure in per_job))
    whole = (sum(cost.run.transactions.values()) / cost.jobs, sum(cost.run.statements.values()) / cost.jobs)
    table.add_row("all", *(f"{figure:.2f}" for figure in (*whole, cost.idle.transactions_per_s())))
    CONSOLE.print(table)


if __name__ == "__main__":
    main()
