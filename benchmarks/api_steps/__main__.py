"""What a request costs the API, and where: `python -m benchmarks.api_steps [--requests 300] [--databases sqlite …]`.

The requests of `benchmarks.load`, one at a time, on 2,000 sequences and 10,000 jobs and a phase with entries. CPU
milliseconds: of the API's own process as the embedded platform runs it, of the client, then of the application in this
process with its threads and without; of the latter the share of each step, sampled (`steps.py`). What is left between
the first and the third is the wire: sockets, HTTP, the event loop.
"""

import argparse
import asyncio
import logging
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from sqlalchemy import select

from api.main import make_api
from benchmarks.api import database_url, serving
from benchmarks.api_rows import STATES, fill
from benchmarks.api_steps.asking import CpuCosts, InProcessClient, MeasuredClient, without_threads
from benchmarks.api_steps.steps import NAMES, StepSamples
from benchmarks.load.clients import READS, LoadPlan, read_path, send_submission, upload
from chaos.scoring_world import build_scoring_world, files
from services.runtime.orm import SequenceRow
from services.runtime.platform import open_platform
from services.runtime.settings import ApiSettings, BrokerSettings, DatabaseSettings, Settings
from services.runtime.telemetry.log_lines import speak_json
from testing.servers.redis import running_redis

WARM, WARMING = 40, "warming up"
READS_PER_UPLOAD = 10
ALIVE = ("list jobs, all alive", "/jobs")
SUBMISSIONS = 12  # three times as many may be open of a team
COLUMNS = ("asked", "requests", "API", "client", "here", "no threads", *NAMES)

ClientMaker = Callable[[str, str], MeasuredClient]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.api_steps", description=__doc__)
    parser.add_argument("--requests", type=int, default=300, help="of each list; of uploads a tenth")
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"], choices=["sqlite", "postgres"])
    options = parser.parse_args()
    for kind in options.databases:
        with tempfile.TemporaryDirectory() as folder, database_url(kind) as url, running_redis() as redis:
            settings = Settings(
                data_folder=Path(folder),
                database=DatabaseSettings(url),
                broker=BrokerSettings(redis.url),
                api=ApiSettings(requests_per_minute=10**8),
            )
            Console(width=220).print(measured(settings, kind, options.requests))


def measured(settings: Settings, kind: str, requests: int) -> Table:
    plan = prepared(settings)
    served, threaded, inline, samples = CpuCosts(), CpuCosts(), CpuCosts(), StepSamples()
    with serving(settings) as (port, pid):
        at_port, clock = replace(plan, port=port), process_clock(pid)
        ask_all(plan, requests, lambda secret, team: MeasuredClient(at_port, secret, clock, served, team))
    app = make_api(open_platform(settings))
    with quiet_json():
        ask_all(plan, requests, lambda secret, team: InProcessClient((plan, secret, team), app, threaded))
        with without_threads(), samples.taken():
            ask_all(plan, requests, lambda secret, team: InProcessClient((plan, secret, team), app, inline, samples))
    table = Table(*COLUMNS, title=f"CPU ms a request (means), shares of the last; {kind}")
    for what in (one for one in inline.server_ms if one != WARMING):
        costs = [served.server_ms[what], served.client_ms[what], threaded.server_ms[what], inline.server_ms[what]]
        shares = samples.shares(what)
        figures = [f"{np.mean(cost):.2f}" for cost in costs] + [f"{shares[name] * 100:.0f} %" for name in NAMES]
        table.add_row(what, str(len(inline.server_ms[what])), *figures)
    return table


@contextmanager
def quiet_json() -> Iterator[None]:
    """Log lines are made as in a process of the API, and thrown away."""
    speak_json()
    handler = logging.root.handlers[0]
    with open(os.devnull, "w") as nowhere:
        before = handler.setStream(nowhere)  # type: ignore[attr-defined]  # which speak_json() made
        yield
        handler.setStream(before)  # type: ignore[attr-defined]


def process_clock(pid: int) -> Callable[[], float]:
    """CPU seconds of another process, to the nanosecond (`clock_getcpuclockid(3)` on Linux)."""
    return lambda: time.clock_gettime((~pid << 3) | 2)


def prepared(settings: Settings) -> LoadPlan:
    """A platform with the rows of `benchmarks.api` and a phase that takes entries; who asks for what."""
    world = build_scoring_world(settings)
    platform = open_platform(settings)
    secrets = [reader.secret for reader in fill(platform.database, 3, STATES)]
    with platform.database.reading() as session:
        sequence = session.scalars(select(SequenceRow.id).where(SequenceRow.name == "forest-0")).one()
    platform.database.close()
    path = settings.root / "guess.zip"
    path.write_bytes(next(iter(files(world).values())))
    captains = tuple((team, captain.secret) for team, captain in zip(world.teams, world.captains, strict=True))
    asked = {"sequence": sequence, "benchmark": "kill", "phase": "val", "phase_id": world.val, "zip_path": str(path)}
    return LoadPlan(0, 0.0, 0.0, 1, 1, 1, tuple(secrets), captains, **asked)


def ask_all(plan: LoadPlan, requests: int, client_of: ClientMaker) -> None:
    """Every kind of request, after some that are not counted."""
    asyncio.run(_ask_all(plan, requests, client_of))


async def _ask_all(plan: LoadPlan, requests: int, client_of: ClientMaker) -> None:
    chance, (team, secret) = random.Random(7), plan.captains[0]
    reader, other, captain = client_of(plan.secrets[0], ""), client_of(plan.secrets[2], ""), client_of(secret, team)
    for client, what, path in (*((reader, what, path) for what, path, _ in READS), (other, *ALIVE)):
        for number in range(WARM + requests):
            await read_path(client, what if number >= WARM else WARMING, path)
        await client.close()  # before the server does, which waits for the next request a few seconds only
    for _ in range(max(1, requests // READS_PER_UPLOAD)):
        await upload(reader, chance)
    for _ in range(SUBMISSIONS):
        await send_submission(captain, chance)
    for client in (reader, other, captain):
        await client.close()


if __name__ == "__main__":
    main()
