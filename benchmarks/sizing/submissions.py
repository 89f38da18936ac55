"""The cost of one submission: sent to a fresh platform with a hidden phase of a given number of frames, and scored."""

import time
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.api import database_url
from benchmarks.season.__main__ import NO_LIMITS, wait_until
from benchmarks.season.people import Season, SeasonTeam, close_all, open_season, signed_in
from benchmarks.season.world import LEVELS, VERSIONS, Predictions, SeasonSize, build_season_world
from benchmarks.sizing.costs import MeasuredCosts
from benchmarks.sizing.holdings import holdings_of
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.embedded.supervisor import running_platform
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, Settings
from services.runtime.store.factory import open_store

SEQUENCES = 2


def submission_costs(frames: int, submissions: int, workers: int) -> MeasuredCosts:
    """Return the mean over `submissions` submissions, sent one after another; `frames` is a multiple of `SEQUENCES`."""
    size = SeasonSize(teams=1, sequences=SEQUENCES, frames=frames // SEQUENCES, scorings=2 * submissions)
    with TemporaryDirectory() as folder, database_url("postgres") as url:
        settings = Settings(
            data_folder=Path(folder) / "data", workers=workers, database=DatabaseSettings(url), api=NO_LIMITS
        )
        upgrade(settings)
        with closing(Database(settings)) as database:
            predictions = build_season_world(Platform(settings, database, open_store(settings)), size)
        with running_platform(settings) as running:
            admin = signed_in(running.url, running.keys.name, running.keys.password)
            season = open_season(admin, VERSIONS[0], size.scorings)
            team = season.found_team(0)
            truths = f"/admin/phases/{season.phase_id}/ground-truths"
            wait_until(lambda: all(truth["state"] == "ready" for truth in admin.pages(truths)))
            before = holdings_of(running.platform)
            packed = _packed(predictions, Path(folder), submissions)
            waited_s = sum(_scored_after_s(season, team, path) for path in packed)
            costs = holdings_of(running.platform).costs_since(before)
            costs["until it is scored, wall s"] = waited_s
            close_all(season, [team])
    return MeasuredCosts(frames, {what: cost / submissions for what, cost in costs.items()})


def _packed(predictions: Predictions, folder: Path, submissions: int) -> list[Path]:
    """Return files of similar quality, each with other levels of its frames."""
    chance = np.random.default_rng(1)
    levels = [chance.integers(0, LEVELS, len(predictions.npz)).tolist() for _ in range(submissions)]
    return [predictions.pack(folder / f"{number}.zip", of_one) for number, of_one in enumerate(levels)]


def _scored_after_s(season: Season, team: SeasonTeam, path: Path) -> float:
    begun_s = time.perf_counter()
    sent = season.submit((team, team.captain), path, path.stem)
    wait_until(lambda: season.states()[sent.id] not in ("queued", "scoring"))
    if season.states()[sent.id] != "scored":
        raise RuntimeError(f"submission {sent.id} ended as {season.states()[sent.id]}")
    return time.perf_counter() - begun_s
