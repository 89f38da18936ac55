"""The board and comparisons over HTTP: what they say, in which forms, and what is refused."""

import csv
import io
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pyarrow.parquet as pq
import pytest

from api.schemas.leaderboard import LeaderboardAnswer
from services.runtime.orm import Phase
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import person
from testing.worlds.made import NOBODY
from tests.api.boarding import answered, boarding, refused
from tests.services.domain.benchmarks.boards import HOUR_NS, Made, scene

FORMS = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
    "md": "text/markdown; charset=utf-8",
    "tex": "application/x-tex; charset=utf-8",
}


def test_a_board_says_by_what_and_how_surely(api_on: httpx.Client, platform_on: Platform) -> None:
    look = boarding(api_on, platform_on)
    board = look.board(look.member)
    LeaderboardAnswer.model_validate(board)
    assert (board["benchmark"], board["phase"], board["track"], board["entries"]) == (
        look.benchmark,
        "val",
        "all",
        "best",
    )
    assert (board["is_hidden"], board["secrecy"], board["is_rounded"], board["ratio_digits"]) == (
        False,
        "open",
        False,
        4,
    )
    assert board["ordered_by"] == ["miou", "iou_occ", "iou_n", "submitted_at"]
    assert (board["pair"]["metric"], board["pair"]["signature"]) == ("stone-iou-2", "metric:a|truth:b")
    assert (board["pair"]["ground_truth"], board["pair"]["frames"], board["pair"]["sequences"]) == (1, 1350, 3)
    assert any("new places: at least 5 sequences are needed, here 3" in note for note in board["notes"])
    first, second = board["rows"]
    assert (first["submission_id"], second["submission_id"]) == (look.mine, look.theirs)
    assert (first["rank"], first["rank_interval"], first["tie_group"]) == (1, [1, 1], 1)
    assert (second["rank"], second["rank_interval"], second["tie_group"]) == (2, [2, 2], 2)
    assert (first["team"], first["is_yours"], second["is_yours"]) == (look.team, True, False)
    low, high = first["intervals"]["miou"]
    assert low < first["ratios"]["miou"] < high
    assert first["support"]["T"] > 0


def test_every_form_has_the_same_rows(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    replies = {form: look.read(f"{look.path}/leaderboard", format=form) for form in FORMS}
    assert {form: reply.headers["content-type"] for form, reply in replies.items()} == FORMS
    for form, reply in replies.items():
        named = f'attachment; filename="{look.benchmark}-val.{form}"'
        assert (reply.status_code, reply.headers["content-disposition"]) == (200, named)
        assert reply.headers["x-content-type-options"] == "nosniff"
    told = [(row["rank"], row["submission_id"], row["ratios"]["miou"]) for row in look.board()["rows"]]
    table = pq.read_table(io.BytesIO(replies["parquet"].content)).to_pylist()
    lines = csv.DictReader(io.StringIO(replies["csv"].text))
    assert [(row["rank"], row["submission_id"], row["miou"]) for row in table] == told
    assert [(int(row["rank"]), row["submission_id"], float(row["miou"])) for row in lines] == told
    assert f"{100 * told[0][2]:.2f}" in replies["md"].text
    assert f"{100 * told[0][2]:.2f}" in replies["tex"].text


def test_a_board_that_did_not_change_is_not_sent_again(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    path = f"{look.path}/leaderboard"
    tags = {form: look.read(path, format=form).headers["etag"] for form in ("json", *FORMS)}
    assert len(set(tags.values())) == len(tags)

    def again(form: str) -> httpx.Response:
        return api.get(path, params={"format": form}, headers={**look.other.headers, "If-None-Match": tags[form]})

    for form, tag in tags.items():
        assert (again(form).status_code, again(form).content, again(form).headers["etag"]) == (304, b"", tag)
    look.at.enter(look.at.team(), Made(0.3))
    for form, tag in tags.items():
        assert again(form).status_code == 200
        assert again(form).headers["etag"] != tag


def test_a_track_and_all_entries_are_asked_for(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    camera = look.at.enter(look.at.team(), Made(0.3), modality="C")
    assert [row["submission_id"] for row in look.board(track="C")["rows"]] == [camera]
    assert [row["rank"] for row in look.board(track="L")["rows"]] == [1, 2]
    team_id = look.at.team()
    worse = [look.at.enter(team_id, Made(error)) for error in (0.5, 0.6)]
    assert worse[1] not in [row["submission_id"] for row in look.board()["rows"]]
    assert worse[1] in [row["submission_id"] for row in look.board(entries="all")["rows"]]


def test_a_board_of_the_past_is_asked_for_by_an_instant(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.change(look.mine, settled_ns=now_ns() - 5 * HOUR_NS)
    then = datetime.now(UTC) - timedelta(hours=2)
    board = look.board(as_of=then.isoformat())
    assert [row["submission_id"] for row in board["rows"]] == [look.mine]
    assert datetime.fromisoformat(board["as_of"]) == then
    long_ago = look.board(as_of="1999-01-01T00:00:00Z")
    assert (long_ago["pair"], long_ago["rows"]) == (None, [])


def test_the_moments_at_which_the_board_changed_are_told_with_the_best_since(
    api: httpx.Client, platform: Platform
) -> None:
    look = boarding(api, platform)
    look.at.change(look.mine, settled_ns=now_ns() - 5 * HOUR_NS)
    told = answered(look.read(f"{look.path}/leaderboard/history"))
    assert [(one["entered"], one["is_new_pair"]) for one in told["changes"]] == [(0, True), (1, False), (1, False)]
    for change in told["changes"]:
        ranked = [row for row in look.board(as_of=change["at"])["rows"] if row["standing"] == "ranked"]
        best = max((round(row["ratios"]["miou"], 4) for row in ranked), default=None)
        assert change["best_miou"] == best
    assert len(answered(look.read(f"{look.path}/leaderboard/history", track="C"))["changes"]) == 1
    assert refused(look.read(f"{look.path}/leaderboard/history", track="X")) == (422, "invalid_request")


def test_what_is_not_a_board_is_refused(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    asked: list[dict[str, Any]] = [
        {"track": "X"},
        {"track": "L+C"},
        {"as_of": "yesterday"},
        {"as_of": "2026-01-01T00:00:00"},
        {"as_of": "9999-12-31T23:59:59Z"},
        {"entries": "worst"},
        {"format": "html"},
    ]
    for query in asked:
        assert refused(look.read(f"{look.path}/leaderboard", **query)) == (422, "invalid_request"), query


def test_an_unnamed_phase_names_nobody_but_oneself(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.change(look.at.phase_id, Phase, named_from_ns=now_ns() + HOUR_NS)
    assert [row["team"] for row in look.board(look.member)["rows"]] == [look.team, None]
    assert look.board(look.other)["rows"][0]["team"] is None
    for form in ("csv", "md", "tex"):
        assert look.team not in look.read(f"{look.path}/leaderboard", look.other, format=form).text
    assert None not in [row["team"] for row in look.board(look.administrator)["rows"]]


def test_a_running_hidden_phase_tells_no_form_more_than_rounded_values(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.hide()
    exact = look.at.score_row(look.mine).miou or 0.0
    for caller in (look.member, look.other, person(platform, "curator")):
        files = {form: look.read(f"{look.path}/leaderboard", caller, format=form).content for form in ("json", *FORMS)}
        board = look.board(caller)
        assert (board["is_rounded"], board["rows"][0]["ratios"]["miou"]) == (True, round(exact, 4))
        assert (board["rows"][0]["intervals"], board["rows"][0]["support"]) == (None, None)
        assert not any(str(exact).encode() in content for content in files.values())
        row = pq.read_table(io.BytesIO(files["parquet"])).to_pylist()[0]
        assert (row["miou"], row["miou_low"]) == (round(exact, 4), None)
    assert look.board(look.administrator)["rows"][0]["ratios"]["miou"] == exact


def test_a_comparison_says_whether_it_is_more_than_chance(api_on: httpx.Client, platform_on: Platform) -> None:
    look = boarding(api_on, platform_on)
    found = answered(look.read(f"{look.path}/compare", a=look.mine, b=look.theirs))
    assert (found["a"], found["b"], found["is_withheld"]) == (look.mine, look.theirs, False)
    miou = found["ratios"]["miou"]
    assert miou["difference"] == pytest.approx(miou["a"] - miou["b"])
    assert 0 < miou["these_places"]["interval"][0] < miou["difference"] < miou["these_places"]["interval"][1]
    assert (miou["new_place"], miou["silences"]["new_place"]) == (None, "few_sequences")
    assert miou["sign_flip"] == {"sequences": 3, "p": 0.25, "smallest_p": 0.25}
    look.at.hide()
    hidden = answered(look.read(f"{look.path}/compare", look.member, a=look.mine, b=look.theirs))
    assert hidden["is_withheld"]
    assert hidden["ratios"]["miou"] == {
        "a": round(miou["a"], 4),
        "b": round(miou["b"], 4),
        "difference": round(round(miou["a"], 4) - round(miou["b"], 4), 4),
        "these_places": None,
        "new_place": None,
        "silences": None,
        "sign_flip": None,
    }


def test_what_cannot_be_compared_is_refused(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    elsewhere = scene(platform)
    foreign = elsewhere.enter(elsewhere.team(), Made())
    gone = look.at.enter(look.at.team(), Made(), withdrawn_ns=1)
    compare = f"{look.path}/compare"
    assert refused(look.read(compare, a=look.mine, b=foreign)) == (409, "not_comparable")
    assert refused(look.read(compare, a=look.mine, b=gone)) == (404, "not_found")
    assert refused(look.read(compare, a=NOBODY, b=look.mine)) == (404, "not_found")
    assert refused(look.read(compare, a=look.mine)) == (422, "invalid_request")
    assert refused(look.read(compare, a="x", b="y")) == (422, "invalid_request")


def test_boards_are_of_phases_that_exist_and_for_those_who_are_signed_in(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    both: dict[str, Any] = {"a": look.mine, "b": look.theirs}
    for what in ("leaderboard", "compare"):
        for at in (f"{look.benchmark}/phases/no", "no/phases/val"):
            assert refused(look.read(f"/api/v1/benchmarks/{at}/{what}", **both)) == (404, "not_found")
        assert api.get(f"{look.path}/{what}", params=both).status_code == 401
