"""Inputs of the scoring rounds: an open phase of two parts' worth of frames, and three files to submit.

**Conventions.** The world is created before the platform starts, by the functions that routes and workers call. A few
grids alternate in the frames, so creating the world takes seconds. Two files are sound, one contains an invalid label
in each of its parts.
"""

from collections.abc import Mapping
from itertools import cycle, islice

import numpy as np
from sqlalchemy import select

from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.submissions.scoring_ranges import PART_FRAMES
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.orm import Dataset, Team, TeamMember
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.factory import open_store
from stone.sensors.sequence import frame_token
from testing.api.serving import Person, person
from testing.worlds import made, published
from testing.worlds.benchmark_world import Grid, World, ground, labelled, run_eval
from testing.worlds.sending import zipped

FRAMES = PART_FRAMES * 6 // 10  # in each of two sequences
GRIDS = 6
NAMES = ("north", "south")


def build_scoring_world(settings: Settings) -> World:
    """Create the phase with its active ground truth, and two teams, in a database that no other process uses."""
    upgrade(settings)
    platform = Platform(settings, Database(settings), open_store(settings))
    administrator, curator = person(platform, "administrator"), person(platform, "curator")
    grids = list(islice(cycle([ground(seed) for seed in range(GRIDS)]), FRAMES))
    ids = [labelled(platform, curator, name, grids, ("forest", "day")) for name in NAMES]
    dataset = published.dataset(platform, administrator.user_id, {"val": ids})
    phase_id = _phase(platform, administrator, dataset)
    captains = tuple(person(platform, "participant") for _ in range(2))
    teams = tuple(_team(platform, captain) for captain in captains)
    run_eval(platform)
    by_token = {name: {_token(name, i): grid for i, grid in enumerate(grids)} for name in NAMES}
    platform.database.close()
    people = (administrator, curator, captains, captains[0], teams)
    return World(platform, *people, "kill", dataset, phase_id, "", {"val": by_token})


def files(world: World) -> Mapping[str, bytes]:
    """Return the files to submit, by name."""
    truth = world.truth("val")
    guesses = {f"shifted by {by}": {token: np.roll(grid, by, axis=0) for token, grid in truth.items()} for by in (1, 3)}
    tokens = list(truth)
    spoilt = dict(guesses["shifted by 1"]) | {token: _spoilt(truth[token]) for token in (tokens[7], tokens[-7])}
    return {name: zipped(world, frames) for name, frames in {**guesses, "spoilt": spoilt}.items()}


def _phase(platform: Platform, administrator: Person, dataset: str) -> str:
    with platform.database.transaction() as session:
        version = session.scalars(select(Dataset).where(Dataset.name == dataset)).one()
        benchmark = create_benchmark(session, NewBenchmark("kill", "", "", administrator.user_id))
        phase = create_phase(session, benchmark, version, NewPhase("val", "val", is_hidden=False))
        start_truth(session, phase, version, administrator.user_id)
        return phase.id


def _team(platform: Platform, captain: Person) -> str:
    with platform.database.transaction() as session:
        team = Team(name=captain.name)
        session.add(team)
        session.flush()
        session.add(TeamMember(team_id=team.id, user_id=captain.user_id, is_owner=True))
        return team.id


def _token(name: str, index: int) -> str:
    return frame_token(name, made.stamp_of(index))


def _spoilt(grid: Grid) -> Grid:
    return np.where(grid == 0, 255, grid).astype(np.uint8)
