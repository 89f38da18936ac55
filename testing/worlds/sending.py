"""A world on a separate platform for a module's tests, and submissions sent into it as a client does.

**Conventions.** Every submission has unique bytes, unless a test changes this, so it never meets another's leftovers.
Rows are read again at every call.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active
from services.domain.benchmarks.submissions.submissions import SubmissionDraft, create_draft, finalise
from services.runtime.orm import Blob, Job, JobLine, Score, ScorePart, ScoringEntry, SubmissionRow, new_id
from services.runtime.platform import Platform
from stone_base.label_grid import PAPER, LabelGrid
from testing.servers.fixtures import make_settings, opened
from testing.worlds import made
from testing.worlds.benchmark_world import Grid, World, benchmark_world, labels_npz
from testing.worlds.submission_files import write_submission


@contextmanager
def standing_world(folder: Path, template: Path, frames: int = 1, grid: LabelGrid = PAPER) -> Iterator[World]:
    """Yield a small world at a grid, copied from a template world, on the migrated `template`."""
    kept = _made_world(template, frames, grid)
    settings = make_settings(folder)
    shutil.copytree(kept.platform.settings.root, settings.root)
    platform = opened(settings, [])
    yield replace(kept, platform=platform)
    platform.database.close()


@cache
def _made_world(template: Path, frames: int, grid: LabelGrid) -> World:
    """Return the world that is copied; it must not change."""
    settings = make_settings(template.parent / f"world-of-{frames}-{grid.name}")
    settings.root.mkdir(parents=True)
    shutil.copyfile(template, settings.root / "stone.sqlite3")
    platform = opened(settings, [])
    made = benchmark_world(platform, frames, grid)
    platform.database.close()
    return made


def guess(world: World, part: str = "val", turn: int = 0) -> dict[str, Grid]:
    """Return a half-right prediction: the truth moved by some voxels, differently for each `turn`."""
    return {token: np.roll(grid, 1 + turn, axis=1) for token, grid in world.truth(part).items()}


def zipped(world: World, frames: Mapping[str, Grid]) -> bytes:
    """Return these frames as a submission."""
    path = Path(world.platform.settings.root) / f"{new_id()}.zip"
    write_submission(path, frames.items(), world.grid)
    return path.read_bytes()


def truth_folder(world: World, part: str, folder: Path) -> Path:
    """Write the labels of a part as files, as `stone score` takes them."""
    for sequence, grids in world.grids[part].items():
        for token, grid in grids.items():
            path = folder / "gts" / sequence / token / "labels.npz"
            path.parent.mkdir(parents=True)
            path.write_bytes(labels_npz(grid))
    return folder


def send(world: World, content: bytes, part: str = "val", **said: Any) -> str:
    """Submit a file and queue its run; return the submission's id. Keywords may set kind and team (number)."""
    digest, team = sha256(content).hexdigest(), said.get("team", 0)
    captain = world.captains[team]
    what = (said.get("kind", "entry"), "a guess", "", "L")
    facts = SubmissionDraft(
        world.phase(part), world.teams[team], captain.user_id, *what, sha256=digest, size_bytes=len(content)
    )
    with world.platform.database.transaction() as session:
        submission_id = create_draft(session, facts).id
    sent = {"purpose": "submission", "target_id": submission_id, "filename": "guess.zip", "declared_sha256": digest}
    upload_id = made.upload(world.platform, captain, content, **sent)
    with world.platform.database.transaction() as session:
        finalise(session, session.get_one(SubmissionRow, submission_id), upload_id)
    return submission_id


def row_of(platform: Platform, submission_id: str) -> SubmissionRow:
    with platform.database.reading() as session:
        return session.get_one(SubmissionRow, submission_id)


def scores_of(platform: Platform, submission_id: str) -> list[Score]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Score).where(Score.submission_id == submission_id).order_by(Score.id)))


def jobs_of(platform: Platform, submission_id: str) -> list[Job]:
    """Return the jobs of its run, in their order."""
    root_id = row_of(platform, submission_id).job_id
    with platform.database.reading() as session:
        return list(session.scalars(select(Job).where(Job.root_id == root_id, Job.queue != "").order_by(Job.id)))


def taken(platform: Platform, submission_id: str) -> int:
    """Return the number of scorings that it uses."""
    with platform.database.reading() as session:
        amounts = select(ScoringEntry.amount).where(ScoringEntry.submission_id == submission_id)
        return sum(session.scalars(amounts))


def parts_left(platform: Platform) -> int:
    """Return the number of counted parts that wait for a join, of all submissions."""
    with platform.database.reading() as session:
        return len(session.scalars(select(ScorePart.start)).all())


def counts_of(platform: Platform, score: Score) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return the stored confusions [F, 3, 4, 4] and drivable columns [F, 3, 3] of a score."""
    with platform.database.reading() as session:
        key = session.get_one(Blob, score.confusions_sha256).object_key
    with np.load(platform.store.local(key), allow_pickle=False) as arrays:
        return arrays["confusions"], arrays["bev"]


def pair_of(world: World, part: str) -> EvaluationVersion:
    """Return the active evaluation version."""
    with world.platform.database.reading() as session:
        version = active(session, world.phase(part))
    assert version is not None
    return version


def outputs_of(platform: Platform, submission_id: str) -> list[Any]:
    """Return all results, failures and log lines of its jobs."""
    jobs = jobs_of(platform, submission_id)
    with platform.database.reading() as session:
        lines = session.scalars(select(JobLine).where(JobLine.job_id.in_([job.id for job in jobs]))).all()
    return [
        *((job.result, job.failure, job.failure_code, job.stage) for job in jobs),
        *((line.event, line.facts) for line in lines),
    ]
