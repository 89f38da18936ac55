"""From the zips of two teams to the board, by the real stages: what is told while the truth is hidden, and what not."""

import hashlib
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from services.domain.benchmarks.submissions.submissions import SubmissionDraft, create_draft, finalise
from services.runtime.orm import SubmissionRow
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.metric import RATIOS
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.benchmark_world import SHAPE, World, benchmark_world, predicted, run_eval, submission_zip
from tests.plain_confusion import confusion_matrix

URL = "/api/v1"


def submit(world: World, part: str, team: int, errors: float, folder: Path) -> str:
    """The id of a finalised submission of the team's captain."""
    path = submission_zip(folder / f"{part}-{team}.zip", predicted(world.truth(part), errors, team))
    content = path.read_bytes()
    facts: dict[str, Any] = {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
    captain = world.captains[team]
    who: dict[str, Any] = {"phase_id": world.phase(part), "team_id": world.teams[team], "user_id": captain.user_id}
    draft = SubmissionDraft(**who, kind="entry", method=f"Net {team}", description="", modality="L", **facts)
    with world.platform.database.transaction() as session:
        submission_id = create_draft(session, draft).id
    upload_id = made.upload(world.platform, captain, content, purpose="submission", target_id=submission_id)
    with world.platform.database.transaction() as session:
        finalise(session, session.get_one(SubmissionRow, submission_id), upload_id)
    return submission_id


def slow_ratios(world: World, part: str, team: int, errors: float) -> list[float]:
    """By counting voxel by voxel."""
    truth = world.truth(part)
    everything = np.ones(SHAPE, bool)
    found = predicted(truth, errors, team)
    total = sum((confusion_matrix(truth[token], found[token], everything) for token in truth), np.zeros((4, 4), int))
    values: list[float] = ratios(total).tolist()
    return values


@pytest.mark.parametrize("part", ["val", "test"])
def test_zips_become_a_board(api: httpx.Client, platform: Platform, tmp_path: Path, part: str) -> None:
    world = benchmark_world(platform, frames=2)
    errors = (0.3, 0.1)
    ids = [submit(world, part, team, error, tmp_path) for team, error in enumerate(errors)]
    run_eval(platform)

    def read(path: str, caller: Person, status: int = 200) -> Any:
        reply = api.get(f"{URL}/{path}", headers=caller.headers)
        assert reply.status_code == status, reply.text
        return reply.json()

    at = f"benchmarks/{world.benchmark}/phases/{part}"
    board = read(f"{at}/leaderboard", world.curator)
    assert [(row["submission_id"], row["rank"]) for row in board["rows"]] == [(ids[1], 1), (ids[0], 2)]
    exact = {name: value for name, value in zip(RATIOS, slow_ratios(world, part, 1, errors[1]), strict=True)}
    told = {name: value if part == "val" else round(value, 4) for name, value in exact.items()}
    assert board["rows"][0]["ratios"] == pytest.approx(told, abs=1e-12)
    assert (board["secrecy"], board["pair"]["sequences"]) == ("open" if part == "val" else "running", 2)
    for caller in (*world.captains, world.member, world.curator):
        shown = read(f"submissions/{ids[1]}/results", caller)
        assert shown["total"] == pytest.approx(told, abs=1e-12)
        assert (shown["confusion"] is None) == (part == "test")
        read(f"submissions/{ids[1]}/results/breakdowns?by=sequence", caller, 200 if part == "val" else 403)
        assert read(f"submissions/{ids[1]}/provenance", caller)["code_version"]
    assert read(f"submissions/{ids[1]}/results", world.administrator)["total"] == pytest.approx(exact, abs=1e-12)
    compared = read(f"{at}/compare?a={ids[1]}&b={ids[0]}", world.captains[1])
    assert compared["ratios"]["miou"]["difference"] > 0
    assert compared["is_withheld"] == (part == "test")
