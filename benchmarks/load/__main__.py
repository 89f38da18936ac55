"""The whole platform under load: `python -m benchmarks.load [--clients 200] [--minutes 10] [--pause-s 1.0] [--slow N]`.

The embedded platform on SQLite or PostgreSQL has 2,000 sequences, 10,000 jobs and an open phase. Clients run in a
process of their own, each with a connection. 90 % read lists, objects and the board, 8 % send files in pieces of 1 MiB,
2 % have submissions scored. Meanwhile recordings are labelled one after another. The tables show errors and latencies
by kind of request. They also show requests per second and CPU ms per request by quarter of the time, and the memory of
every process in the first and the last quarter.

With `--slow 2000`, 2,000 connections of one address stop within a request (`benchmarks/load/strangers.py`) after
`CALM_S`. Then nothing is labelled or scored, and the platform's limits stay in force. Without `--slow` the clients'
address is exempt. With `--pause-s 0` clients do not pause, so latencies are those of an overloaded platform.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from sqlalchemy import select

from benchmarks.api import database_url
from benchmarks.api_rows import ENDED, fill
from benchmarks.load.clients import LoadPlan
from benchmarks.load.quarters import UNTIL_SCORED, quarters
from benchmarks.load.strangers import StrangersPlan
from benchmarks.memory_watch import MemoryWatch
from chaos.api_calls import await_run, begin_run, upload_sequence
from chaos.inputs import Inputs, simulated
from chaos.places import PlatformUnderTest
from chaos.scoring_world import build_scoring_world, files
from chaos.turns import StuckError
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.orm import SequenceRow
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings, ViewingSettings
from stone.errors import StoneError
from stone_client.api import Api
from testing.worlds.benchmark_world import World

MIB = 2**20
LABELLED_WITHIN_S = 600.0
CALM_S = 20.0
CLIENTS_AT, PROXY = "127.0.0.2", "192.0.2.1"  # no connection comes from PROXY, so no address is exempt
CONSOLE = Console(width=130, highlight=False)


def main() -> int:
    options = _options()
    inputs = simulated(options.folder / "inputs")
    with ExitStack() as stack:
        url = stack.enter_context(database_url(options.database))
        api = ApiSettings(port=0, requests_per_minute=10**9, **options.api)
        settings = Settings(
            data_folder=options.folder / "data",
            workers=options.workers,
            database=DatabaseSettings(url),
            api=api,
            viewing=ViewingSettings(makes_playback=False),
        )
        world = build_scoring_world(settings)
        readers = _readers(settings)
        running = stack.enter_context(running_platform(settings, CONSOLE.print))
        world = replace(world, platform=running.platform)
        plan = _plan(options, running, world, readers)
        labelling = _Labelling(PlatformUnderTest(running, inputs), inputs)
        others = _Strangers(options, running)
        with MemoryWatch(running) as watch, others, nullcontext() if options.slow else labelling:
            noted = clients(options.folder, plan)
    _show(options, noted, labelling)
    _show_quarters(noted, watch)
    _show_memory(watch)
    if options.slow:
        others.show(noted, watch)
    return 1 if noted["error_count"] or labelling.failures else 0


def _readers(settings: Settings) -> list[str]:
    from services.runtime.database.transactions import Database

    database = Database(settings)
    try:
        return [reader.secret for reader in fill(database, 40, ENDED)]
    finally:
        database.close()


def _plan(options: argparse.Namespace, running: RunningPlatform, world: World, secrets: list[str]) -> LoadPlan:
    """Return the plan: `clients` shared among the kinds; the submitted file is in the data folder."""
    path = running.platform.settings.root / "guess.zip"
    path.write_bytes(next(iter(files(world).values())))
    submitters = 0 if options.slow else max(1, options.clients * 2 // 100)
    uploaders = max(1, options.clients * 8 // 100)
    with running.platform.database.reading() as session:
        sequence = session.scalars(select(SequenceRow.id).where(SequenceRow.name == "forest-0")).one()
    return LoadPlan(
        port=running.platform.settings.api.port,
        seconds=options.minutes * 60.0,
        pause_s=options.pause_s,
        readers=options.clients - submitters - uploaders,
        uploaders=uploaders,
        submitters=submitters,
        secrets=tuple(secrets[::8]),  # tokens of the owner of the requested sequence
        captains=tuple((team, captain.secret) for team, captain in zip(world.teams, world.captains, strict=True)),
        sequence=sequence,
        benchmark="kill",
        phase="val",
        phase_id=world.val,
        zip_path=str(path),
        source=CLIENTS_AT,
    )


def clients(folder: Path, plan: LoadPlan) -> dict[str, Any]:
    """Return the clients' log from a process of their own."""
    plan_file, out = folder / "plan.json", folder / "noted.json"
    plan_file.write_text(json.dumps(asdict(plan)))
    subprocess.run([sys.executable, "-m", "benchmarks.load.clients", plan_file, out], check=True)
    noted: dict[str, Any] = json.loads(out.read_text())
    return noted


class _Labelling:
    """A thread that uploads and labels one recording after another, each for a new owner."""

    def __init__(self, target: PlatformUnderTest, inputs: Inputs) -> None:
        self.runs, self.failures = 0, list[str]()
        self._place, self._inputs = target, inputs
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._label, name="labelling")

    def __enter__(self) -> "_Labelling":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _label(self) -> None:
        while not self._over.is_set():
            try:
                with Api(self._place.welcome(f"field-{self.runs}").server, patience_s=120.0) as api:
                    run = begin_run(api, upload_sequence(api, self._inputs), self._inputs)
                    state = await_run(api, run.run_id, LABELLED_WITHIN_S)
            except (StoneError, StuckError) as error:
                state = f"{type(error).__name__}: {error}"
            self.runs += 1
            if state != "succeeded":
                self.failures.append(state)
                return


class _Strangers:
    """The connections of `benchmarks.load.strangers`, in a process of their own beside the clients."""

    def __init__(self, options: argparse.Namespace, running: RunningPlatform) -> None:
        self._plan = StrangersPlan(
            running.platform.settings.api.port, options.slow, CALM_S, options.minutes * 60.0 - CALM_S
        )
        self._log, self._folder = running.logs / "api.log", options.folder
        self._noted: dict[str, Any] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._skipped = 0

    def __enter__(self) -> None:
        self._skipped = len(self._log.read_text().splitlines())
        plan_path = self._folder / "strangers.json"
        plan_path.write_text(json.dumps(asdict(self._plan)))
        command = [sys.executable, "-m", "benchmarks.load.strangers", plan_path, self._folder / "seen.json"]
        if self._plan.count:
            self._process = subprocess.Popen(command)

    def __exit__(self, *_: object) -> None:
        if self._process:
            self._process.wait()
            self._noted = json.loads((self._folder / "seen.json").read_text())

    def show(self, noted: dict[str, Any], watch: MemoryWatch) -> None:
        """Print the API's memory (before, and the maximum), the clients' latencies and the number of log lines."""
        begun_s = self._noted["begun_s"]
        held = dict(zip(watch.looked_s, watch.held["api"], strict=False))
        before = median(size for at_s, size in held.items() if begun_s - CALM_S / 2 < at_s < begun_s)
        most = max(size for at_s, size in held.items() if at_s >= begun_s)
        pairs = [(at_s, s) for what in noted["begun_s"] for at_s, s in _pairs(noted, what) if what != UNTIL_SCORED]
        for name, waited in (
            ("before", [s for at_s, s in pairs if at_s + s < begun_s]),
            ("beside", [s for at_s, s in pairs if at_s + s >= begun_s]),
        ):
            p50, p99 = np.percentile(waited, [50, 99]) * 1e3
            CONSOLE.print(f"{name} them: {len(waited)} requests, p50 {p50:.0f} ms, p99 {p99:.0f} ms")
        lines = self._log.read_text().splitlines()[self._skipped :]
        request_lines = sum('"logger": "access"' in line or '"event": "request"' in line for line in lines)
        CONSOLE.print(
            f"strangers: {self._plan.count}, {self._noted['most_open']} open at most, ended by {self._noted['seen']}; "
            f"API {before / MIB:.0f} MiB before, {most / MIB:.0f} at most (+{(most - before) / MIB:.0f}); "
            f"{len(lines) - request_lines} log lines besides {request_lines} of requests"
        )


def _pairs(noted: dict[str, Any], what: str) -> Iterable[tuple[float, float]]:
    return zip(noted["begun_s"][what], noted["waited_s"][what], strict=True)


def _show(options: argparse.Namespace, noted: dict[str, Any], labelling: _Labelling) -> None:
    waited_s: dict[str, list[float]] = noted["waited_s"]
    title = f"{options.clients} clients, {options.minutes:g} minutes, pause {options.pause_s:g} s, {options.database}"
    table = Table("asked", "count", "p50 ms", "p99 ms", "max ms", title=title)
    for what, seconds in sorted(waited_s.items()):
        p50, p99 = np.percentile(seconds, [50, 99]) * 1e3
        table.add_row(what, str(len(seconds)), f"{p50:.1f}", f"{p99:.1f}", f"{max(seconds) * 1e3:.0f}")
    CONSOLE.print(table)
    requests = sum(len(seconds) for what, seconds in waited_s.items() if what != UNTIL_SCORED)
    took_s = options.minutes * 60.0
    CONSOLE.print(
        f"{requests} requests, {requests / took_s:.0f} per second, {noted['error_count']} errors; "
        f"{noted['sent_bytes'] / MIB / took_s:.1f} MiB/s sent; {noted['scored']} submissions scored, "
        f"{labelling.runs} recordings labelled, {len(labelling.failures)} failed"
    )
    for words in (*noted["errors"], *labelling.failures):
        CONSOLE.print(f"  {words}")


def _show_quarters(noted: dict[str, Any], watch: MemoryWatch) -> None:
    names = list(watch.used_s)
    columns = ("quarter", "requests/s", "p50 ms", "p99 ms", *names)
    table = Table(*columns, title="by quarter of the time; programs: CPU ms per request")
    for number, quarter in enumerate(quarters(noted["begun_s"], noted["waited_s"], watch), 1):
        waited = (f"{quarter.requests_per_s:.0f}", f"{quarter.p50_ms:.0f}", f"{quarter.p99_ms:.0f}")
        table.add_row(str(number), *waited, *(f"{quarter.cpu_ms[name]:.2f}" for name in names))
    CONSOLE.print(table)


def _show_memory(watch: MemoryWatch) -> None:
    table = Table("process", "first quarter MiB", "last quarter MiB", "most MiB", title="memory (PSS, medians)")
    for name, held in watch.held.items():
        quarter = max(1, len(held) // 4)
        figures = (median(held[:quarter]), median(held[-quarter:]), max(held))
        table.add_row(name, *(f"{figure / MIB:.0f}" for figure in figures))
    CONSOLE.print(table)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load", description=__doc__)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--pause-s", type=float, default=1.0, help="pause of a client between two requests, seconds")
    parser.add_argument("--database", default="postgres", choices=["sqlite", "postgres"])
    parser.add_argument("--slow", type=int, default=0, help="number of connections that stop in a request (default: 0)")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="data folder (default: a temporary folder)")
    options = parser.parse_args()
    options.api = {"trusted_proxies": PROXY} if options.slow else {"trusted_proxies": CLIENTS_AT}
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-load-"))).absolute()
    return options


if __name__ == "__main__":
    begun_s = time.monotonic()
    ended = main()
    CONSOLE.print(f"{time.monotonic() - begun_s:.0f} s in all")
    sys.exit(ended)
