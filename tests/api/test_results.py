"""Results over HTTP: what a submission scored, for whom; the matrix of `seen_fields.py` again, through the routes."""

import hashlib
import io
from typing import Any

import httpx
import numpy as np
import pytest

from services.runtime.orm import Phase, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import person
from testing.worlds.made import NOBODY
from tests.api.boarding import Boarding, answered, boarding, refused
from tests.services.domain.benchmarks.boards import HOUR_NS, Made, counts
from tests.services.domain.benchmarks.seen_fields import RELATIONS, STANDINGS, expected

BY = ("sequence", "environment", "illumination", "distance")
PARTS = ("results", "provenance", "confusions", "results/breakdowns")
# What of the results' body each field of the table is.
BODY_OF = {
    "intervals": "intervals",
    "support": "support",
    "confusion": "confusion",
    "extras": "extras",
    "within occupied": "within_occupied",
    "method": "method",
    "description": "description",
    "team": "team",
}


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


def test_a_submission_that_is_not_on_the_board_is_its_teams(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.change(look.mine, hidden_ns=1)
    for part in PARTS:
        replies = [look.of(look.mine, part, who, by="sequence") for who in (look.member, look.administrator)]
        assert [reply.status_code for reply in replies] == [200, 200], part
        theirs, nothing = (look.of(one, part, look.other, by="sequence") for one in (look.mine, NOBODY))
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
        assert refused(look.of(queued, part, look.member, by="sequence")) == (409, "not_scored")
        assert refused(look.of(queued, part, look.other, by="sequence")) == (404, "not_found")
        assert api.get(f"/api/v1/submissions/{look.mine}/{part}?by=sequence").status_code == 401


def test_an_older_score_is_read_by_its_id(api_on: httpx.Client, platform_on: Platform) -> None:
    look = boarding(api_on, platform_on)
    pending = look.at.another_pair()
    shadow = look.at.score(look.mine, Made(0.1), pending)
    assert refused(look.of(look.mine, "results", look.member, score=shadow)) == (404, "score_missing")
    assert answered(look.of(look.mine, "results", look.administrator, score=shadow))["score_id"] == shadow
    now = answered(look.of(look.mine, "results", look.member))
    assert [one["is_active"] for one in now["scores"]] == [True]
    newest = look.at.another_pair(activated_ns=now_ns())
    fresh = look.at.score(look.mine, Made(0.3), newest)
    after = answered(look.of(look.mine, "results"))
    assert (after["score_id"], [one["score_id"] for one in after["scores"]]) == (fresh, [now["score_id"], fresh])
    old = answered(look.of(look.mine, "results", score=now["score_id"]))
    assert (old["total"], old["pair"]) == (now["total"], now["pair"])
    by_sequence = look.of(look.mine, "results/breakdowns", score=now["score_id"], by="sequence")
    assert answered(by_sequence)["score_id"] == now["score_id"]
    assert refused(look.of(look.mine, "results", score=look.at.score_row(look.theirs).id)) == (404, "score_missing")


def test_the_counts_come_as_a_file_with_its_checksum(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    reply = look.of(look.mine, "confusions", look.member)
    assert reply.headers["etag"] == f'"{hashlib.sha256(reply.content).hexdigest()}"'
    assert "attachment" in reply.headers["content-disposition"]
    with np.load(io.BytesIO(reply.content), allow_pickle=False) as arrays:
        assert np.array_equal(arrays["confusions"], counts(Made(0.2)))
    part = api.get(reply.request.url, headers={**look.member.headers, "Range": "bytes=2-5"})
    assert (part.status_code, part.content) == (206, reply.content[2:6])


def test_a_breakdown_is_by_something(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    asked: list[dict[str, Any]] = [{}, {"by": "weather"}, {"by": "sequence", "score": "x"}]
    for query in asked:
        assert refused(look.of(look.mine, "results/breakdowns", **query)) == (422, "invalid_request")


def test_what_is_withheld_says_until_when(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.hide()
    reply = look.of(look.mine, "results/breakdowns", look.member, by="sequence")
    assert refused(reply) == (403, "withheld")
    assert "while the phase runs only totals rounded" in reply.json()["detail"]
