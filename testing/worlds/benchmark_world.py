"""A small benchmark on a platform: sequences with real label grids, a dataset version, two phases and two teams.

One phase is open, one hidden, each with ready ground truth; an administrator owns them.

**Conventions.** Only the labels are rows written here; the platform's own functions create everything else. Grids come
from formulas, a few milliseconds each, and are equal for equal seeds. The hidden grids contain `CANARY`, a unique
pattern of voxels. `run_eval` runs the jobs of the queue `eval` in this process.
"""

import hashlib
import io
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select

from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.teams.teams import invite, join
from services.eval.queue_handlers import handlers
from services.runtime.jobs.execution import run_next
from services.runtime.orm import Benchmark, Dataset, GroundTruthRow, Phase, SequenceRow, Team, TeamMember, User, new_id
from services.runtime.platform import Platform
from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER, LabelGrid
from stone_files.npz import npz_bytes
from testing.api.serving import Person, person
from testing.worlds import made, published

Grid = NDArray[np.uint8]
SHAPE = (256, 256, 32)
FRAMES = 4
CONDITIONS = {
    "train": (("meadow", "day"),),
    "val": (("forest", "day"), ("lake", "night")),
    "test": (("quarry", "day"), ("farmland", "dusk")),
}
CANARY = np.array([3, 1, 3, 2, 1, 3, 3, 1], np.uint8)
CANARY_AT = (5, 7, slice(12, 20))


@dataclass(frozen=True, eq=False)
class World:
    """`grids` are the labels by part, sequence name and token, all at `grid`; `captains` lead `teams`, one each."""

    platform: Platform
    administrator: Person
    curator: Person
    captains: tuple[Person, ...]
    member: Person
    teams: tuple[str, ...]
    benchmark: str
    dataset: str
    val: str
    test: str
    grids: Mapping[str, Mapping[str, Mapping[str, Grid]]]
    grid: LabelGrid = PAPER

    def phase(self, part: str) -> str:
        """Return the id of the phase over this part."""
        return {"val": self.val, "test": self.test}[part]

    def truth(self, part: str) -> Mapping[str, Grid]:
        """Return the grids of a part by token, in the order of its manifest."""
        return {token: grid for of_sequence in self.grids[part].values() for token, grid in of_sequence.items()}

    @cached_property
    def hidden_files(self) -> tuple[bytes, ...]:
        """Return the bytes of the hidden frames' label files."""
        return tuple(labels_npz(grid) for grid in self.truth("test").values())


def ground(seed: int, canary: bool = False) -> Grid:
    """Return a rolling sheet of ground with patches of T, P and N and a few blocks on it."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(SHAPE[0]), np.arange(SHAPE[1]), indexing="ij")
    waves = random.uniform(0.02, 0.06, 4)
    height = 10 + 4 * np.sin(waves[0] * x + seed) * np.cos(waves[1] * y)
    patches = np.sin(waves[2] * x - seed) + np.sin(waves[3] * y)
    classes = (1 + (patches > 0.3).astype(np.uint8) + (patches > 1.2)).astype(np.uint8)
    layer = np.arange(SHAPE[2])
    grid = np.where(np.abs(layer - height[..., None]) <= 0.8, classes[..., None], 0).astype(np.uint8)
    for _ in range(6):
        i, j = random.integers(0, 240, 2)
        grid[i : i + 8, j : j + 8, 12:24] = 3
    if canary:
        grid[CANARY_AT] = CANARY
    return grid


def mistaken(truth: Grid, errors: float, seed: int = 0) -> Grid:
    """Return the grid with a share `errors` of its columns shifted by a voxel and some of their classes changed."""
    random = np.random.default_rng(seed)
    is_wrong = random.random(truth.shape[:2]) < errors
    changed = np.where(truth > 0, truth % 3 + 1, 0).astype(np.uint8)
    grid = np.where(is_wrong[..., None], np.roll(truth, 1, axis=2), truth)
    return np.where((is_wrong & (random.random(truth.shape[:2]) < 0.5))[..., None], changed, grid).astype(np.uint8)


def labels_npz(grid: Grid) -> bytes:
    """Return the label file of a frame; every voxel within 20 m was observed."""
    seen = np.zeros(grid.shape, np.uint8)
    seen[28:228, 28:228] = 1
    return npz_bytes({"semantics": grid, "mask_lidar": seen, "mask_camera": seen})


def submission_zip(path: Path, frames: Mapping[str, Grid]) -> Path:
    """Write the predictions as a participant's script does: `numpy.savez_compressed` in a zip."""
    with zipfile.ZipFile(path, "w") as archive:
        for token, grid in frames.items():
            content = io.BytesIO()
            np.savez_compressed(content, semantics=grid)
            archive.writestr(f"{token}.npz", content.getvalue())
    return path


def predicted(truth: Mapping[str, Grid], errors: float, seed: int = 0) -> dict[str, Grid]:
    """Return a submission's frames: the truth with errors, drawn separately for each frame."""
    return {token: mistaken(grid, errors, seed + number) for number, (token, grid) in enumerate(truth.items())}


def run_eval(platform: Platform) -> int:
    """Run the queue `eval` until it is empty; return the number of jobs."""
    ran = 0
    while run_next(platform, "eval", handlers(platform)):
        ran += 1
    return ran


def benchmark_world(platform: Platform, frames: int = FRAMES, grid: LabelGrid = PAPER) -> World:
    """Create the world, labelled at a grid no wider than the paper's; it takes about a second."""
    administrator, curator = person(platform, "administrator"), person(platform, "curator")
    grids, ids = _sequences(platform, curator, frames, grid)
    dataset = published.dataset(platform, administrator.user_id, ids)
    benchmark, phases = benchmark_over(platform, administrator, dataset)
    captains = (person(platform, "participant"), person(platform, "participant"))
    teams = tuple(team_led_by(platform, captain) for captain in captains)
    member = person(platform, "participant")
    with platform.database.transaction() as session:
        team, captain = session.get_one(Team, teams[0]), session.get_one(User, captains[0].user_id)
        join(session, invite(session, team, captain), session.get_one(User, member.user_id))
    at = (administrator, curator, captains, member, teams)
    return World(platform, *at, benchmark, dataset, phases["val"], phases["test"], grids, grid)


def new_truth(platform: Platform, phase_id: str, user_id: str) -> str:
    """Create another ground truth of the phase from its own dataset version; return its id once it is ready."""
    with platform.database.transaction() as session:
        phase = session.get_one(Phase, phase_id)
        truth, _job = start_truth(session, phase, session.get_one(Dataset, phase.dataset_id), user_id)
        truth_id = truth.id
    run_eval(platform)
    with platform.database.reading() as session:
        assert session.get_one(GroundTruthRow, truth_id).ready_ns is not None
    return truth_id


def sha256_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _sequences(
    platform: Platform, owner: Person, frames: int, grid: LabelGrid
) -> tuple[dict[str, Any], dict[str, list[str]]]:
    grids: dict[str, dict[str, dict[str, Grid]]] = {}
    ids: dict[str, list[str]] = {}
    seed = 0
    for part, conditions in CONDITIONS.items():
        grids[part], ids[part] = {}, []
        for environment, illumination in conditions:
            name = f"{part}-{environment}-{new_id()[-6:]}"
            of_sequence = [cut_to(ground(seed := seed + 1, canary=part == "test"), grid) for _ in range(frames)]
            ids[part].append(labelled(platform, owner, name, of_sequence, (environment, illumination), grid))
            tokens = [frame_token(name, made.stamp_of(index)) for index in range(frames)]
            grids[part][name] = dict(zip(tokens, of_sequence, strict=True))
        grids[part] = dict(sorted(grids[part].items()))
    return grids, ids


def cut_to(labels: Grid, grid: LabelGrid) -> Grid:
    """Return the corner of labels that has a grid's shape."""
    x, y, z = grid.shape
    return np.ascontiguousarray(labels[:x, :y, :z])


def labelled(
    platform: Platform,
    owner: Person,
    name: str,
    grids: Iterable[Grid],
    said: tuple[str, str] = ("meadow", "day"),
    grid: LabelGrid = PAPER,
) -> str:
    """Create a sequence with these label grids and return its id."""
    environment, illumination = said
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name=name, environment=environment, illumination=illumination)
        session.add(row)
        session.flush()
        facts = {"id": row.id, "name": row.name, "owner_id": owner.user_id}
    made.labels(platform, facts, seed=row.id.encode(), contents=[labels_npz(labels) for labels in grids], grid=grid)
    return row.id


def benchmark_over(platform: Platform, administrator: Person, dataset: str) -> tuple[str, dict[str, str]]:
    """Create a benchmark with phases over val (open) and test (hidden) of a version; return its name and phases."""
    with platform.database.transaction() as session:
        version = session.scalars(select(Dataset).where(Dataset.name == dataset)).one()
        new = NewBenchmark(f"stone-{new_id()[-6:]}", "STONE", "Traversability of voxels", administrator.user_id)
        benchmark: Benchmark = create_benchmark(session, new)
        val = create_phase(session, benchmark, version, NewPhase("val", part="val", is_hidden=False))
        test = create_phase(session, benchmark, version, NewPhase("test", part="test", is_hidden=True))
        for phase in (val, test):
            start_truth(session, phase, version, administrator.user_id)
        name, phases = benchmark.name, {"val": val.id, "test": test.id}
    run_eval(platform)
    with platform.database.reading() as session:
        ready = select(GroundTruthRow.phase_id).where(GroundTruthRow.ready_ns.is_not(None))
        assert set(session.scalars(ready.where(GroundTruthRow.phase_id.in_(phases.values())))) == set(phases.values())
    return name, phases


def team_led_by(platform: Platform, captain: Person) -> str:
    """Create a team and return its id."""
    with platform.database.transaction() as session:
        team = Team(name=f"team-{new_id()[-8:]}")
        session.add(team)
        session.flush()
        session.add(TeamMember(team_id=team.id, user_id=captain.user_id, is_owner=True))
        return team.id
