"""The accuracy of the remaining time of a labelling: `python -m benchmarks.time_left`.

One embedded platform in a fresh folder, so that the first run has no history; simulated sequences are uploaded and
labelled one after the other, like in the demo. Twice a second the inputs of the estimate are read from the database,
and the result from `GET /jobs/{id}`. At the end the estimates at a quarter, half and three quarters of each run are
compared with the truth. The last line is the median error at half-time, and the exit status is 1 if it is above the
limit.

`--save FILE` stores the readings, `--replay FILE` estimates from them again: this tunes the constants of
`services/domain/runs/time_left.py`, in a second per try.
"""

import argparse
import json
import os
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import median
from threading import Event, Thread
from typing import Any

from rich.console import Console
from rich.table import Table
from sqlalchemy import select

from services.domain.runs.estimates import alive_rows, alive_runs, pace_of
from services.domain.runs.time_left import Pace, RunningJob, RunWorkload, StageWork, rounded_s, seconds_left
from services.runtime.embedded.supervisor import running_platform
from services.runtime.orm import Job
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

EVERY_S = 0.5
KEPT_S = 10.0
LIMIT = 0.25
PLACES = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class RunGlance:
    """The knowledge of a run `at_s` after its start, and the API's answer."""

    at_s: float
    work: RunWorkload
    pace: Pace
    shown_s: int | None

    def estimated_s(self) -> int | None:
        left_s = seconds_left(self.work, self.pace)
        return None if left_s is None else rounded_s(left_s)


@dataclass(frozen=True)
class LabellingTrace:
    """A run of `total_s`, sampled while it ran; `spent` are its jobs' seconds by kind."""

    total_s: float
    looks: tuple[RunGlance, ...]
    spent: dict[str, list[float]]
    recorded_s: float

    def look_at(self, share: float) -> RunGlance:
        """Return the first sample at or after this share of the run."""
        return next((look for look in self.looks if look.at_s >= share * self.total_s), self.looks[-1])

    def error(self, share: float) -> float:
        """Return |estimate − truth| / truth at this share of the run; 1 without an estimate."""
        look = self.look_at(share)
        truth_s = self.total_s - look.at_s
        estimate_s = look.estimated_s()
        return 1.0 if estimate_s is None or truth_s <= 0 else abs(estimate_s - truth_s) / truth_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--replay", type=Path)
    options = parser.parse_args()
    if options.replay:
        traces = read_traces(options.replay)
    else:
        traces = measured(options.folder, options.runs, options.seconds, options.workers)
        if options.save:
            options.save.write_text(
                json.dumps([thinned(trace) for trace in traces], separators=(",", ":")) + "\n", "utf-8"
            )
    _show(traces)
    worst = median(trace.error(0.5) for trace in traces)
    print(f"median error at half-time: {worst:.0%} (limit {LIMIT:.0%})")
    sys.exit(1 if worst > LIMIT else 0)


def measured(folder: Path, runs: int, seconds: float, workers: int) -> list[LabellingTrace]:
    """Label `runs` simulated sequences on a fresh platform, one after the other."""
    folder.mkdir(parents=True, exist_ok=True)
    bags = [folder / f"time-left-{seconds:g}-{seed}.mcap" for seed in range(runs)]
    for seed, bag in enumerate(bags):
        if not bag.exists():
            simulate(bag, SimulateOptions(seconds=seconds, seed=seed))
    with tempfile.TemporaryDirectory(dir=folder) as home:
        settings = Settings(data_folder=Path(home), workers=workers, api=ApiSettings(port=0))
        with running_platform(settings) as running, Api(Server(running.url, running.keys.token)) as api:
            return [_traced(running.platform, api, bag) for bag in bags]


def _traced(platform: Platform, api: Api, bag: Path) -> LabellingTrace:
    sequence = ensure_sequence(api, bag.stem)
    pin_calibration(api, sequence, calibration_path(bag))
    add_recording(api, sequence, hashed_bag(bag, _silent), _silent)
    run_id = start_run(api, sequence, {})["id"]
    looks, ended = list[tuple[int, RunWorkload, Pace, int | None]](), Event()

    def watch() -> None:
        while not ended.wait(EVERY_S):
            if (look := _looked_at(platform, api, run_id)) is not None:
                looks.append(look)

    watcher = Thread(target=watch, name="watch", daemon=True)
    watcher.start()
    follow(api, run_id, _silent)
    ended.set()
    watcher.join()
    return _trace(platform, run_id, looks)


def _looked_at(platform: Platform, api: Api, run_id: str) -> tuple[int, RunWorkload, Pace, int | None] | None:
    """Return a sample; None before the run starts and after it ends."""
    at_ns = now_ns()
    with platform.database.reading() as session:
        run = session.get_one(Job, run_id)
        if run.state != "running":
            return None
        (alive,) = alive_runs(session, alive_rows(session, [run_id]), at_ns)
        pace = pace_of(session, run.kind)
    return at_ns, alive.work, pace, api.read(f"/jobs/{run_id}")["progress"]["eta_s"]


def _trace(
    platform: Platform, run_id: str, looks: Sequence[tuple[int, RunWorkload, Pace, int | None]]
) -> LabellingTrace:
    with platform.database.reading() as session:
        run = session.get_one(Job, run_id)
        jobs = session.scalars(select(Job).where(Job.root_id == run_id, Job.queue != "")).all()
    begun_ns, ended_ns = run.started_ns or 0, run.finished_ns or 0
    spent = defaultdict[str, list[float]](list)
    for job in jobs:
        spent[job.kind].append(((job.finished_ns or 0) - (job.started_ns or 0)) / 1e9)
    seen = tuple(RunGlance((at_ns - begun_ns) / 1e9, work, pace, shown_s) for at_ns, work, pace, shown_s in looks)
    recorded_s = next((look.work.recorded_s for look in seen if look.work.recorded_s), 0.0)
    return LabellingTrace((ended_ns - begun_ns) / 1e9, seen, dict(spent), recorded_s)


def thinned(trace: LabellingTrace) -> dict[str, Any]:
    """Return the trace as JSON, with a sample every `KEPT_S` and at the shown shares."""
    kept, next_s = list[RunGlance](), 0.0
    shown = {trace.look_at(share).at_s for share in PLACES}
    for look in trace.looks:
        if look.at_s >= next_s or look.at_s in shown:
            kept.append(look)
            next_s = max(next_s, look.at_s + KEPT_S) if look.at_s >= next_s else next_s
    record = recorded(LabellingTrace(trace.total_s, tuple(kept), trace.spent, trace.recorded_s))
    rounded: dict[str, Any] = json.loads(json.dumps(record), parse_float=lambda text: round(float(text), 3))
    return rounded


def recorded(value: Any) -> Any:
    """Return the value for JSON; values with fields become objects."""
    if isinstance(value, LabellingTrace | RunGlance | Pace):
        return {field.name: recorded(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, RunWorkload | StageWork | RunningJob):
        return {name: recorded(item) for name, item in value._asdict().items()}
    return [recorded(item) for item in value] if isinstance(value, tuple) else value


def read_traces(path: Path) -> list[LabellingTrace]:
    """Return the traces of `--save`."""
    return [_read_trace(record) for record in json.loads(path.read_text("utf-8"))]


def _read_trace(record: dict[str, Any]) -> LabellingTrace:
    looks = tuple(
        RunGlance(look["at_s"], _read_work(look["work"]), Pace(**look["pace"]), look["shown_s"])
        for look in record["looks"]
    )
    return LabellingTrace(record["total_s"], looks, record["spent"], record["recorded_s"])


def _read_work(record: dict[str, Any]) -> RunWorkload:
    stages = tuple(
        StageWork(**{**stage, "running": tuple(RunningJob(**job) for job in stage["running"])})
        for stage in record["stages"]
    )
    return RunWorkload(**{**record, "stages": stages})


def _show(traces: Sequence[LabellingTrace]) -> None:
    console = Console()
    table = Table(title=f"time left, load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for column in ("run", "total s", *(f"at {share:.0%}: estimate, true s, error" for share in PLACES), "history"):
        table.add_column(column, justify="right")
    for number, trace in enumerate(traces, 1):
        cells = [_cell(trace, share) for share in PLACES]
        history = "yes" if trace.looks[0].pace.seconds else "no"
        table.add_row(str(number), f"{trace.total_s:.0f}", *cells, history)
    console.print(table)
    print("TYPICAL, as measured:")
    for kind, seconds in _typical(traces):
        print(f'    "{kind}": {seconds:.2f},')


def _cell(trace: LabellingTrace, share: float) -> str:
    look = trace.look_at(share)
    return f"{look.estimated_s()}, {trace.total_s - look.at_s:.0f}, {trace.error(share):.0%}"


def _typical(traces: Sequence[LabellingTrace]) -> Iterable[tuple[str, float]]:
    """Return mean seconds per job by kind; for synchronisation per recorded second."""
    for kind in traces[0].spent:
        jobs_s = [second for trace in traces for second in trace.spent.get(kind, ())]
        units = sum(trace.recorded_s for trace in traces) if kind == "ingest.synchronise" else len(jobs_s)
        yield kind, sum(jobs_s) / units if units else 0.0


def _silent(_stage: str, _done: int, _total: int) -> None:
    return


if __name__ == "__main__":
    main()
