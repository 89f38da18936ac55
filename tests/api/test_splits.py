"""Splits: who may put them, that every rule is checked, that a change means what was read, and what is proposed."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from services.runtime.orm import LabelSet, SequenceRow, SplitMember
from services.runtime.platform import Platform
from stone.splits.surroundings import ENVIRONMENTS
from testing.api.serving import Person, person
from testing.worlds.published import published_sequence

URL = "/api/v1/splits"
Put = Callable[..., httpx.Response]


@pytest.fixture
def put(api: httpx.Client, platform: Platform) -> Put:
    return putting(api, platform)


@pytest.fixture
def put_on(api_on: httpx.Client, platform_on: Platform) -> Put:
    return putting(api_on, platform_on)


def putting(api: httpx.Client, platform: Platform) -> Put:
    """PUT of splits by an administrator: the three lists of ids; `match` is the If-Match."""
    headers = person(platform, "administrator").headers

    def asked(
        train: list[str], val: list[str], test: list[str], match: str = "*", reason: str = "why"
    ) -> httpx.Response:
        body = {"train": train, "val": val, "test": test, "reason": reason}
        return api.put(URL, json=body, headers={**headers, "If-Match": match})

    return asked


def driven(platform: Platform, owner: Person, **said: str) -> str:
    facts = {"environment": "lake", "illumination": "day", **said}
    return published_sequence(platform, owner.user_id, **facts)


def codes(answer: httpx.Response) -> list[str]:
    return [error["code"] for error in answer.json()["errors"]]


def test_what_is_put_is_what_is_read(put_on: Put, api_on: httpx.Client, platform_on: Platform) -> None:
    owner = person(platform_on, "curator")
    a, b, c, d = (driven(platform_on, owner, region=f"r{n}") for n in range(4))
    answer = put_on([a], [b], [c])
    assert answer.status_code == 200
    assert answer.headers["etag"] == '"1"'
    administrator = person(platform_on, "administrator")
    read = api_on.get(URL, headers=administrator.headers)
    assert read.headers["etag"] == '"1"'
    assert read.json() == answer.json()
    shown = read.json()
    assert shown["sizes"] == {"train": 1, "val": 1, "test": 1}
    assert [[one["sequence_id"] for one in shown[part]] for part in ("train", "val", "test", "unassigned")] == [
        [a], [b], [c], [d]
    ]  # fmt: skip
    assert shown["train"][0]["voxels"] == {
        "traversable": 100, "potentially_traversable": 200, "non_traversable": 700
    }  # fmt: skip


def test_a_change_names_the_revision_it_means(put: Put, platform: Platform, curator: Person) -> None:
    a = driven(platform, curator)
    assert put([a], [], [], match='"0"').status_code == 200
    stale = put([], [], [], match='"0"')
    assert (stale.status_code, stale.json()["code"]) == (412, "precondition_failed")
    assert put([], [], [], match='"1"').json()["sizes"] == {"train": 0, "val": 0, "test": 0}


def test_a_change_without_a_revision_or_a_reason_is_refused(put: Put, api: httpx.Client, platform: Platform) -> None:
    headers = person(platform, "administrator").headers
    body = {"train": [], "val": [], "test": [], "reason": "why"}
    assert api.put(URL, json=body, headers=headers).status_code == 428
    assert put([], [], [], reason=" ").status_code == 422


def test_every_broken_rule_is_named_and_nothing_is_put(put: Put, platform: Platform, curator: Person) -> None:
    a, b, c = (driven(platform, curator, region="Seoul") for _ in range(3))
    short = driven(platform, curator, region="Busan")
    with platform.database.transaction() as session:
        labels = session.query(LabelSet).where(LabelSet.sequence_id == short).one()
        labels.duration_ns = 19 * 10**9
        name = session.get_one(SequenceRow, short).name
    answer = put([a, b, "0" * 32], [b, short], [c])
    assert (answer.status_code, answer.json()["code"]) == (422, "split_refused")
    assert codes(answer) == ["whole_sequences", "whole_sequences", "sequence_length", "test_regions"]
    unknown, _, length, regions = answer.json()["errors"]
    assert unknown["where"] == "0" * 32
    assert length["where"] == name
    assert "19.0 s; the least is 20 s" in length["expected"]
    assert "'Seoul' is in test" in regions["expected"]
    with platform.database.reading() as session:
        assert session.query(SplitMember).count() == 0


def test_day_and_night_and_environments_are_asked_for_where_the_data_allow(
    put: Put, platform: Platform, curator: Person
) -> None:
    nights = [driven(platform, curator, illumination="moonlit", region=f"n{n}") for n in range(3)]
    days = [driven(platform, curator, region=f"d{n}") for n in range(3)]
    answer = put([*nights, days[0]], [days[1]], [days[2]])
    assert codes(answer) == ["day_and_night"]
    assert answer.json()["errors"][0]["expected"] == "night is not in val and test, though 3 sequences have it"
    good = put(*([night, day] for night, day in zip(nights, days, strict=True)))
    assert good.status_code == 200
    warned = [finding for finding in good.json()["findings"] if finding["severity"] == "warning"]
    assert [finding["code"] for finding in warned] == ["every_environment"] * 3
    assert {finding["message"].split()[0] for finding in warned} == {*ENVIRONMENTS} - {"lake"}


@pytest.mark.parametrize("role", ["participant", "curator"])
def test_others_see_the_sizes_and_where_their_own_are(
    put: Put, api: httpx.Client, platform: Platform, curator: Person, role: str
) -> None:
    mine = driven(platform, curator, region="a")
    other = person(platform, role)
    put([mine], [driven(platform, curator, region="b")], [])
    shown = api.get(URL, headers=other.headers).json()
    assert shown["sizes"] == {"train": 1, "val": 1, "test": 0}
    assert (shown["train"], shown["unassigned"], shown["findings"]) == ([], [], None)
    assert [one["sequence_id"] for one in api.get(URL, headers=curator.headers).json()["train"]] == [mine]


def test_a_sequence_that_is_deleted_leaves_a_finding(put_on: Put, api_on: httpx.Client, platform_on: Platform) -> None:
    owner = person(platform_on, "curator")
    mine = driven(platform_on, owner)
    put_on([mine], [], [])
    assert api_on.delete(f"/api/v1/sequences/{mine}", headers={**owner.headers, "If-Match": "*"}).status_code == 204
    shown = api_on.get(URL, headers=person(platform_on, "administrator").headers).json()
    (finding, *_) = shown["findings"]
    assert (finding["code"], finding["severity"], finding["sequence_ids"]) == ("whole_sequences", "error", [mine])


def judged(api: httpx.Client, who: Person, train: list[str], val: list[str], test: list[str]) -> httpx.Response:
    return api.post(f"{URL}/verdicts", json={"train": train, "val": val, "test": test}, headers=who.headers)


def test_verdicts_are_those_of_putting_and_nothing_is_put(
    put: Put, api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    a, b, c = (driven(platform, curator, region="Seoul") for _ in range(3))
    refused = judged(api, administrator, [a, b], [], [c]).json()
    assert (refused["revision"], refused["can_be_put"]) == (0, False)
    errors = [one for one in refused["findings"] if one["severity"] == "error"]
    assert [one["code"] for one in errors] == codes(put([a, b], [], [c])) == ["test_regions"]
    assert sorted(errors[0]["sequence_ids"]) == sorted([a, b, c])
    kept = judged(api, administrator, [a], [b], []).json()
    assert kept["can_be_put"] is True
    assert kept["findings"] == put([a], [b], []).json()["findings"]
    assert judged(api, administrator, [], [], []).json() == {"revision": 1, "can_be_put": True, "findings": []}


def proposed(api: httpx.Client, who: Person, train: int, val: int, test: int, **more: Any) -> httpx.Response:
    body = {"sizes": {"train": train, "val": val, "test": test}, **more}
    return api.post(f"{URL}/proposal", json=body, headers=who.headers)


def test_a_proposal_can_be_put_as_it_is(
    api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    ids = [
        driven(platform, curator, environment=ENVIRONMENTS[n % 2], illumination=light, region=f"r{n % 4}")
        for n in range(7)
        for light in ("day", "night")
    ]
    answer = proposed(api, administrator, 6, 4, 3, leave_out=ids[:1])
    assert answer.status_code == 200
    found = answer.json()
    assert (found["is_feasible"], found["conflict"]) == (True, [])
    parts = {part: [one["sequence_id"] for one in found[part]] for part in ("train", "val", "test")}
    assert [len(ids) for ids in parts.values()] == [6, 4, 3]
    assert all(ids[0] not in of_part for of_part in parts.values())
    headers = {**administrator.headers, "If-Match": "*"}
    assert api.put(URL, json={**parts, "reason": "as proposed"}, headers=headers).status_code == 200
    assert sum(found["shares"][part]["duration_ratio"] for part in parts) == pytest.approx(1)


def test_a_proposal_that_cannot_be_names_the_rules_that_clash(
    api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    for _ in range(4):
        driven(platform, curator, region="Seoul")
    found = proposed(api, administrator, 2, 1, 1).json()
    assert found["is_feasible"] is False
    assert [rule["code"] for rule in found["conflict"]] == ["test_regions", "split_sizes"]
    assert "1 region(s): seoul 4" in found["conflict"][0]["message"]
    assert [len(found[part]) for part in ("train", "val", "test")] == [2, 1, 1]


def test_what_cannot_be_proposed_is_refused(api: httpx.Client, administrator: Person) -> None:
    assert proposed(api, administrator, 1, 1, 1).json()["code"] == "empty_catalogue"
    assert proposed(api, administrator, 0, 0, 0).json()["code"] == "bad_split_sizes"
    assert proposed(api, administrator, -1, 0, 0).status_code == 422


def test_putting_splits_is_in_the_audit_log(
    api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    mine = driven(platform, curator)
    body = {"train": [mine], "val": [], "test": [], "reason": "first try"}
    api.put(URL, json=body, headers={**administrator.headers, "If-Match": "*"})
    (line,) = [
        line
        for line in api.get("/api/v1/admin/audit-log", headers=administrator.headers).json()["items"]
        if line["act"] == "splits.put"
    ]
    assert (line["actor"], line["reason"]) == (administrator.name, "first try")
    assert line["facts"] == {"train": 1, "val": 0, "test": 0, "revision": 1}
