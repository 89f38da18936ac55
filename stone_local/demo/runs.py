"""The demo's runs: what each robot is, under which conditions it drove, and its recording.

**Conventions.** The first run is the one to look at: cameras, 10 sweeps a second; it is train. The other two are val
and cheap: LiDAR only, 2 sweeps a second, at 4 m/s. Neighbouring frames see the same ground, so an interval needs
metres: 480 of them give that of the mIoU; the 30 of the first run, at 10 sweeps a second, give none.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.splits.splits import SHORTEST_S
from stone_client.progress import Report

SEQUENCE = "demo"
TRAIN, VAL = "train", "val"
SPARSE = SimulateOptions(
    seconds=60.0, channels=32, columns=450, cameras=False, lidar_hz=2, speed_m_s=4.0, world_width_m=80.0
)


@dataclass(frozen=True)
class DemoRun:
    """A run: the name of its sequence, its split, its robot, and the recording conditions."""

    name: str
    part: str
    simulation: SimulateOptions
    conditions: Mapping[str, str]


@dataclass(frozen=True)
class DemoRecording:
    """A recorded run and the folder that everything about it goes to."""

    run: DemoRun
    folder: Path

    @property
    def bag(self) -> Path:
        return self.folder / "run.mcap"

    @property
    def calibration(self) -> Path:
        return calibration_path(self.bag)

    @property
    def labels(self) -> Path:
        return self.folder / "labels"


def demo_runs(shown: SimulateOptions) -> tuple[DemoRun, ...]:
    """The runs of a demo that shows this robot; of one that is too short for a split, that run only."""
    day = DemoRun(SEQUENCE, TRAIN, shown, _conditions("mountain", "day", "north"))
    if shown.seconds < SHORTEST_S:
        return (day,)
    dusk, night = (replace(SPARSE, seed=seed, illumination=light) for seed, light in ((31, "dusk"), (32, "night")))
    return (
        day,
        DemoRun(f"{SEQUENCE}-dusk", VAL, dusk, _conditions("mountain", "dusk", "south")),
        DemoRun(f"{SEQUENCE}-night", VAL, night, _conditions("mountain", "night", "east")),
    )


def recorded_runs(folder: Path, runs: tuple[DemoRun, ...], progress: Report) -> Sequence[DemoRecording]:
    """The recordings in `folder`, in the order of the runs: the first is made here, the others beside it."""
    first, *others = (DemoRecording(run, folder / run.name.removeprefix(SEQUENCE).lstrip("-")) for run in runs)
    with ProcessPoolExecutor(max(1, len(others)), get_context("spawn")) as pool:
        for one in others:
            one.folder.mkdir()
        made = [pool.submit(simulate, one.bag, one.run.simulation) for one in others]
        simulate(first.bag, first.run.simulation, folder / "truth", progress)
        for is_made in made:
            is_made.result()
    return first, *others


def _conditions(environment: str, illumination: str, region: str) -> Mapping[str, str]:
    return {"environment": environment, "illumination": illumination, "region": region, "platform": "simulated"}
