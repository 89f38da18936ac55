"""Results over HTTP: what a submission scored, for whom; the matrix of `seen_fields.py` again, through the routes."""

import hashlib
import io
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from services.domain.benchmarks.submissions.submissions import SubmissionDraft, create_draft, finalise
from services.runtime.orm import Phase, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.metric import RATIOS
from testing.api.serving import Person, person
from testing.worlds import made
from testing.worlds.benchmark_world import SHAPE, World, benchmark_world, predicted, run_eval, submission_zip
from testing.worlds.made import NOBODY
from tests.api.boarding import Boarding, answered, boarding, refused
from tests.plain_confusion import confusion_matrix
from tests.services.domain.benchmarks.boards import HOUR_NS, Made, counts
from tests.services.domain.benchmarks.seen_fields import RELATIONS, STANDINGS, expected

BY = ("sequence", "environment", "illumination", "distance")
PARTS = ("results", "provenance", "confusions", "results/breakdowns")
# What of the results' body each field of the table is.
BODY_OF = {
    "intervals": "intervals", "support": "support", "confusion": "confusion", "extras": "extras",
    "within occupied": "within_occupied", "tolerant": "tolerant", "columns": "columns",
    "method": "method", "description": "description", "team": "team",
}  # fmt: skip


def standing(at: Boarding, name: str) -> None:
    if name == "running":
        at.at.hide(closes_ns=now_ns() + HOUR_NS)
    elif name == "ended":
        at.at.end()
    elif name == "unnamed":
        at.at.change(at.at.phase_id, Phase, named_from_ns=now_ns() + HOUR_NS)


def seen(look: Boarding, caller: Any) -> set[str]:
    """The fields that the caller is answered by any route."""
    body = answered(look.of(look.mine, "results", caller))
    origin = answered(look.of(look.mine, "provenance", caller))
    row = next(row for row in look.board(caller)["rows"] if row["submission_id"] == look.mine)
    compared = answered(look.read(f"{look.path}/compare", caller, a=look.mine, b=look.theirs))["ratios"]["miou"]
    exact = look.at.score_row(look.mine).miou
    totals = (body["total"]["miou"], row["ratios"]["miou"])
    told: dict[str, Any] = {field: body[name] or row.get(name) for field, name in BODY_OF.items()}
    told |= {
        "exact totals": exact in totals,
        "rounded totals": {round(total, 4) for total in totals} == {round(exact or 0, 4)},
        "ranks": row["rank_interval"] or row["tie_group"],
        "comparison": compared["these_places"] or compared["silences"] or compared["sign_flip"],
        "content": origin["content_sha256"],
        "file": origin["prediction_sha256"] or origin["size_bytes"],
        "signature": origin["pair"]["signature"],
        "code version": origin["code_version"],
        "by frame": is_told(look.of(look.mine, "confusions", caller)),
        **{by: is_told(look.of(look.mine, "results/breakdowns", caller, by=by)) for by in BY},
        "frames": refused(look.of(look.mine, f"frames/{NOBODY}.png", caller)) != (403, "frames_hidden"),
        "predictions": is_told(look.of(look.mine, "predictions.zip", caller)),
        "baseline zip": gives_baseline(look, caller),
    }
    return {field for field, value in told.items() if value}


def gives_baseline(look: Boarding, caller: Any) -> bool:
    """Whether the caller is given the zip of `mine` where it is a baseline."""
    look.at.change(look.mine, kind="baseline")
    reply = look.of(look.mine, "predictions.zip", caller)
    look.at.change(look.mine, kind="entry")
    return is_told(reply)


def is_told(reply: httpx.Response) -> bool:
    """Whether it was answered; what is withheld is refused by its own code."""
    if reply.status_code == 200 or refused(reply) == (404, "predictions_gone"):  # the scene keeps no zip
        return True
    assert refused(reply) == (403, "withheld")
    return False


@pytest.mark.whole
@pytest.mark.parametrize("name", STANDINGS)
def test_every_caller_is_answered_exactly_what_the_table_says(api: httpx.Client, platform: Platform, name: str) -> None:
    """An administrator whose token is for reading only is anybody."""
    look = boarding(api, platform)
    standing(look, name)
    modest = person(platform, "administrator", scopes=["read"])
    callers = {"a": look.administrator, "m": look.member, "o": look.other}
    for relation in RELATIONS:
        assert seen(look, callers[relation]) == expected(name, relation), relation
    assert seen(look, modest) == expected(name, "o")


def query_of(part: str) -> dict[str, str]:
    return {"by": "sequence"} if part.endswith("breakdowns") else {}


def test_a_submission_that_is_not_on_the_board_is_its_teams(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.change(look.mine, hidden_ns=1)
    for part in PARTS:
        replies = [look.of(look.mine, part, who, **query_of(part)) for who in (look.member, look.administrator)]
        assert [reply.status_code for reply in replies] == [200, 200], part
        theirs, nothing = (look.of(one, part, look.other, **query_of(part)) for one in (look.mine, NOBODY))
        assert refused(theirs) == refused(nothing) == (404, "not_found")
        assert theirs.json()["detail"].replace(look.mine, "ID") == nothing.json()["detail"].replace(NOBODY, "ID")


def test_what_is_not_scored_yet_says_so_to_its_team_and_nothing_is_for_nobody(
    api: httpx.Client, platform: Platform
) -> None:
    look = boarding(api, platform)
    with platform.database.reading() as session:
        team_id = session.get_one(SubmissionRow, look.mine).team_id
    queued = look.at.enter(team_id, None, state="queued")
    for part in PARTS:
        assert refused(look.of(queued, part, look.member, **query_of(part))) == (409, "not_scored")
        assert refused(look.of(queued, part, look.other, **query_of(part))) == (404, "not_found")
        assert api.get(f"/api/v1/submissions/{look.mine}/{part}", params=query_of(part)).status_code == 401


def test_an_older_score_is_read_by_its_id(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    pending = look.at.another_pair()
    shadow = look.at.score(look.mine, Made(0.1), pending)
    assert refused(look.of(look.mine, "results", look.member, score=shadow)) == (404, "score_missing")
    assert answered(look.of(look.mine, "results", look.administrator, score=shadow))["score_id"] == shadow
    now = answered(look.of(look.mine, "results", look.member))
    look.at.score(look.mine, Made(0.3), look.at.another_pair(activated_ns=now_ns()))
    old = answered(look.of(look.mine, "results", score=now["score_id"]))
    assert (old["total"], old["pair"]) == (now["total"], now["pair"])
    by_sequence = look.of(look.mine, "results/breakdowns", score=now["score_id"], by="sequence")
    assert answered(by_sequence)["score_id"] == now["score_id"]


def test_the_counts_come_as_a_file_with_its_checksum(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    reply = look.of(look.mine, "confusions", look.member)
    assert reply.headers["etag"] == f'"{hashlib.sha256(reply.content).hexdigest()}"'
    assert "attachment" in reply.headers["content-disposition"]
    with np.load(io.BytesIO(reply.content), allow_pickle=False) as arrays:
        assert np.array_equal(arrays["confusions"], counts(Made(0.2)))
    part = api.get(reply.request.url, headers={**look.member.headers, "Range": "bytes=2-5"})
    assert (part.status_code, part.content) == (206, reply.content[2:6])


V1 = "/api/v1"


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


@pytest.mark.whole
@pytest.mark.parametrize("part", ["val", "test"])
def test_zips_become_a_board(api: httpx.Client, platform: Platform, tmp_path: Path, part: str) -> None:
    world = benchmark_world(platform, frames=2)
    errors = (0.3, 0.1)
    ids = [submit(world, part, team, error, tmp_path) for team, error in enumerate(errors)]
    run_eval(platform)

    def read(path: str, caller: Person, status: int = 200) -> Any:
        reply = api.get(f"{V1}/{path}", headers=caller.headers)
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
