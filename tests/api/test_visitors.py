"""Who looks without an account: what is public is shown, the rest is asked to sign in for, hidden truth to nobody."""

import httpx
import pytest
from sqlalchemy import select

from services.runtime.orm import Benchmark, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.worlds.benchmark_world import World, benchmark_world
from tests.api.boarding import URL, Boarding, boarding


@pytest.fixture
def world(platform: Platform) -> World:
    return benchmark_world(platform)


@pytest.fixture
def board(api: httpx.Client, platform: Platform) -> Boarding:
    return boarding(api, platform)


def make_public(platform: Platform) -> None:
    """Everything, by the rows: what hides itself must stay hidden all the same."""
    with platform.database.transaction() as session:
        for kind in (SequenceRow, Benchmark):
            for row in session.scalars(select(kind)):
                row.is_public = True


def test_a_public_sequence_of_a_hidden_phase_is_shown_to_nobody_but_its_owner(api: httpx.Client, world: World) -> None:
    make_public(world.platform)
    hidden = set(world.grids["test"])
    for headers in ({}, world.captains[0].headers):
        items = api.get(f"{URL}/sequences", headers=headers).json()["items"]
        assert {item["name"] for item in items} == set(world.grids["train"]) | set(world.grids["val"])
    everything = api.get(f"{URL}/sequences", headers=world.curator.headers).json()["items"]
    assert {item["name"] for item in everything} >= hidden
    token = next(iter(world.truth("test")))
    seen = next(iter(world.truth("val")))
    assert api.get(f"{URL}/frames/{token}/labels.npz").status_code == 401
    assert api.get(f"{URL}/frames/{token}/labels.npz", headers=world.captains[0].headers).status_code == 404
    assert api.get(f"{URL}/frames/{seen}/labels.npz").status_code == 200


def test_a_sequence_that_is_hidden_truth_cannot_be_made_public(api: httpx.Client, world: World) -> None:
    items = api.get(f"{URL}/sequences", headers=world.curator.headers).json()["items"]
    for item in items:
        match = {"If-Match": f'"{item["revision"]}"', **world.curator.headers}
        answer = api.patch(f"{URL}/sequences/{item['id']}", json={"is_public": True}, headers=match)
        is_hidden = item["name"] in world.grids["test"]
        assert answer.status_code == (409 if is_hidden else 200)
        assert not is_hidden or answer.json()["code"] == "hidden_truth"


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
