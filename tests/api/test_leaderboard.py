"""The board and comparisons over HTTP: what they say, in which forms, and what is refused."""

import csv
import io
from datetime import UTC, datetime, timedelta

import httpx
import pyarrow.parquet as pq
import pytest
from sqlalchemy import select

from api.schemas.leaderboard import LeaderboardAnswer
from services.runtime.orm import Benchmark, Phase, SequenceRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import NOBODY
from tests.api.boarding import URL, Boarding, answered, boarding, refused
from tests.services.domain.benchmarks.boards import HOUR_NS, Made, scene

FORMS = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
    "md": "text/markdown; charset=utf-8",
    "tex": "application/x-tex; charset=utf-8",
}


def test_a_board_says_by_what_and_how_surely(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
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
    assert any(
        "unseen places: at least 5 sequences that do not continue each other are required, this phase has 3" in note
        for note in board["notes"]
    )
    first, second = board["rows"]
    assert (first["submission_id"], second["submission_id"]) == (look.mine, look.theirs)
    assert (first["rank"], first["rank_interval"], first["tie_group"]) == (1, [1, 1], 1)
    assert (second["rank"], second["rank_interval"], second["tie_group"]) == (2, [2, 2], 2)
    assert (first["team"], first["is_yours"], second["is_yours"]) == (look.team, True, False)
    low, high = first["intervals"]["miou"]
    assert low < first["ratios"]["miou"] < high
    assert first["support"]["traversable"] > 0
    extras = answered(look.of(look.mine, "results"))["extras"]
    assert first["danger"] == {name: extras[name] for name in ("n_predicted_drivable_ratio", "n_predicted_t_ratio")}
    assert 0 < first["danger"]["n_predicted_drivable_ratio"] < second["danger"]["n_predicted_drivable_ratio"] < 1


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


def test_a_board_of_the_past_is_asked_for_by_an_instant(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    look.at.change(look.mine, settled_ns=now_ns() - 5 * HOUR_NS)
    then = datetime.now(UTC) - timedelta(hours=2)
    board = look.board(as_of=then.isoformat())
    assert [row["submission_id"] for row in board["rows"]] == [look.mine]
    assert datetime.fromisoformat(board["as_of"]) == then
    long_ago = look.board(as_of="1999-01-01T00:00:00Z")
    assert (long_ago["pair"], long_ago["rows"]) == (None, [])


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
        assert (board["rows"][0]["danger"], row["n_predicted_drivable_ratio"], row["n_predicted_t_ratio"]) == (
            None,
        ) * 3
    assert look.board(look.administrator)["rows"][0]["ratios"]["miou"] == exact


def test_a_comparison_says_whether_it_is_more_than_chance(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    found = answered(look.read(f"{look.path}/compare", a=look.mine, b=look.theirs))
    assert (found["a"], found["b"], found["is_withheld"]) == (look.mine, look.theirs, False)
    miou = found["ratios"]["miou"]
    assert miou["difference"] == pytest.approx(miou["a"] - miou["b"])
    assert 0 < miou["these_places"]["interval"][0] < miou["difference"] < miou["these_places"]["interval"][1]
    assert (miou["new_place"], miou["silences"]["new_place"]) == (None, "few_sequences")
    assert miou["sign_flip"] == {"sequences": 3, "p": 0.25, "smallest_p": 0.25}


def test_what_cannot_be_compared_is_refused(api: httpx.Client, platform: Platform) -> None:
    look = boarding(api, platform)
    elsewhere = scene(platform)
    foreign = elsewhere.enter(elsewhere.team(), Made())
    gone = look.at.enter(look.at.team(), Made(), withdrawn_ns=1)
    compare = f"{look.path}/compare"
    assert refused(look.read(compare, a=look.mine, b=foreign)) == (409, "not_comparable")
    assert refused(look.read(compare, a=look.mine, b=gone)) == (404, "not_found")
    assert refused(look.read(compare, a=NOBODY, b=look.mine)) == (404, "not_found")


@pytest.fixture
def board(api: httpx.Client, platform: Platform) -> Boarding:
    return boarding(api, platform)


def make_public(platform: Platform) -> None:
    """Everything, by the rows: what hides itself must stay hidden all the same."""
    with platform.database.transaction() as session:
        for kind in (SequenceRow, Benchmark):
            for row in session.scalars(select(kind)):
                row.is_public = True


def test_an_unpublished_benchmark_asks_a_visitor_to_sign_in(board: Boarding) -> None:
    phase = board.path
    for path in (phase, f"{phase}/leaderboard", f"{phase}/manifest", f"{URL}/benchmarks/{board.benchmark}"):
        assert board.api.get(path).status_code == 401
    assert board.of(board.mine, "results").status_code == 200
    assert board.api.get(f"{URL}/submissions/{board.mine}/results").status_code == 401
    assert board.api.get(f"{URL}/benchmarks").json()["items"] == []


def test_a_visitor_reads_the_board_of_a_public_benchmark_as_others_do(board: Boarding) -> None:
    make_public(board.at.platform)
    shown = board.api.get(f"{board.path}/leaderboard").json()
    others = board.board(board.other)
    assert [row["submission_id"] for row in shown["rows"]] == [row["submission_id"] for row in others["rows"]]
    assert not any(row["is_yours"] for row in shown["rows"])
    results = f"{URL}/submissions/{board.mine}/results"
    assert board.api.get(results).json()["total"] == board.of(board.mine, "results", board.other).json()["total"]
    pair = {"a": board.mine, "b": board.theirs}
    assert board.api.get(f"{board.path}/compare", params=pair).status_code == 200
    assert board.api.get(f"{URL}/submissions/{board.mine}").status_code == 401
    assert board.api.get(f"{URL}/submissions/{board.mine}/confusions").status_code == 403


def test_an_administrator_opens_a_benchmark_and_says_why(board: Boarding) -> None:
    path, admin = f"{URL}/admin/benchmarks/{board.benchmark}", board.administrator.headers
    assert board.api.patch(path, json={"is_public": True}, headers=admin).status_code == 422
    changed = board.api.patch(path, json={"is_public": True, "reason": "season"}, headers=admin)
    assert changed.json()["is_public"] is True
    assert [one["name"] for one in board.api.get(f"{URL}/benchmarks").json()["items"]] == [board.benchmark]


def test_a_token_that_is_false_is_refused_where_none_would_do(api: httpx.Client, participant: Person) -> None:
    false = {"Authorization": "Bearer stone_" + "0" * 40}
    assert api.get(f"{URL}/sequences", headers=false).status_code == 401
    assert api.get(f"{URL}/sequences", headers={"Cookie": "stone_session=ended"}).status_code == 200
    assert api.get(f"{URL}/sequences", headers=participant.headers).status_code == 200
