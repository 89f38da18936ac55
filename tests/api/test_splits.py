"""Splits and statistics: rules are checked, a change means what was read, sums are of what the caller may see."""

import io
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from services.domain.datasets.composition_figure import composition_png, figure_title
from services.domain.datasets.statistics import statistics_record
from services.runtime.orm import LabelSet, SequenceRow, SplitMember
from services.runtime.platform import Platform
from stone.labels.class_colours import CLASS_RGB
from stone.splits.composition import CatalogueEntry
from stone.splits.surroundings import ENVIRONMENTS
from testing.api.serving import Person, person
from testing.worlds.published import dataset, published_sequence
from tests.stone.catalogues import catalogue, entry

URL = "/api/v1/splits"
Put = Callable[..., httpx.Response]


@pytest.fixture
def put(api: httpx.Client, platform: Platform) -> Put:
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


def test_what_is_put_is_what_is_read(put: Put, api: httpx.Client, platform: Platform) -> None:
    owner = person(platform, "curator")
    a, b, c, d = (driven(platform, owner, region=f"r{n}") for n in range(4))
    answer = put([a], [b], [c])
    assert answer.status_code == 200
    assert answer.headers["etag"] == '"1"'
    administrator = person(platform, "administrator")
    read = api.get(URL, headers=administrator.headers)
    assert read.headers["etag"] == '"1"'
    assert read.json() == answer.json()
    shown = read.json()
    assert shown["sizes"] == {"train": 1, "val": 1, "test": 1}
    assert [[one["sequence_id"] for one in shown[part]] for part in ("train", "val", "test", "unassigned")] == [
        [a], [b], [c], [d]
    ]  # fmt: skip
    assert shown["train"][0]["voxels"] == {
        "free": None, "traversable": 100, "potentially_traversable": 200, "non_traversable": 700
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
    assert "19.0 s; the minimum is 20 s" in length["detail"]
    assert "'Seoul' is in test" in regions["detail"]
    with platform.database.reading() as session:
        assert session.query(SplitMember).count() == 0


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


def test_a_sequence_that_is_deleted_leaves_a_finding(put: Put, api: httpx.Client, platform: Platform) -> None:
    owner = person(platform, "curator")
    mine = driven(platform, owner)
    put([mine], [], [])
    assert api.delete(f"/api/v1/sequences/{mine}", headers={**owner.headers, "If-Match": "*"}).status_code == 204
    shown = api.get(URL, headers=person(platform, "administrator").headers).json()
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
    assert judged(api, administrator, [], [], []).json() == {
        "revision": 1,
        "can_be_put": True,
        "findings": [],
        "gap": None,
    }


def proposed(api: httpx.Client, who: Person, train: int, val: int, test: int, **more: Any) -> httpx.Response:
    body = {"sizes": {"train": train, "val": val, "test": test}, **more}
    return api.post(f"{URL}/proposal", json=body, headers=who.headers)


@pytest.mark.whole
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
    assert "1 region(s): Seoul 4" in found["conflict"][0]["message"]
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


STATISTICS = "/api/v1/statistics"


@pytest.fixture
def lakes_and_farm(platform: Platform) -> tuple[Person, list[str]]:
    """A curator with a lake by day, a lake by night and a farm of which nothing was counted."""
    owner = person(platform, "curator")
    lakes = [published_sequence(platform, owner.user_id, environment="lake", illumination=i) for i in ("dusk", "night")]
    farm = published_sequence(platform, owner.user_id, environment="farmland", region="Seoul")
    with platform.database.transaction() as session:
        row = session.query(LabelSet).where(LabelSet.sequence_id == farm).one()
        row.distance_m = row.t_voxels = row.p_voxels = row.n_voxels = row.held_out_recall = row.held_out_m = None
    return owner, [*lakes, farm]


def test_the_sums_are_those_of_the_rows(api: httpx.Client, lakes_and_farm: tuple[Person, list[str]]) -> None:
    shown = api.get(STATISTICS, headers=lakes_and_farm[0].headers).json()
    assert shown["dataset"] is None
    assert shown["total"] == {
        "sequences": 3, "drives": 3, "frames": 9, "duration_s": 75.0, "distance_m": 61.0, "distances_known": 2,
        "voxels": {"free": None, "traversable": 200, "potentially_traversable": 400, "non_traversable": 1400},
        "class_ratios": {"traversable": 0.1, "potentially_traversable": 0.2, "non_traversable": 0.7}, "voxels_known": 2,
        "held_out_recall": 0.9731, "held_out_m": 150.8, "held_out_known": 2,
        "gravest": {"code": "LAB-605", "harm": "wrong"},
    }  # fmt: skip
    assert [(one["key"], one["sequences"]) for one in shown["environments"]] == [("farmland", 1), ("lake", 2)]
    assert [(one["key"], one["sequences"]) for one in shown["halves"]] == [("day", 1), ("night", 1), ("", 1)]
    assert [(one["key"], one["sequences"]) for one in shown["regions"]] == [("Seoul", 1), ("", 2)]
    assert [(one["environment"], one["illumination"]) for one in shown["cells"]] == [
        ("farmland", ""), ("lake", "dusk"), ("lake", "night")
    ]  # fmt: skip
    farm = shown["environments"][0]
    assert (farm["voxels"], farm["class_ratios"], farm["distance_m"]) == (None, None, None)


def test_everybody_sees_the_sums_of_what_they_may_see(
    api: httpx.Client, platform: Platform, lakes_and_farm: tuple[Person, list[str]]
) -> None:
    def seen(role: str) -> int:
        total: dict[str, int] = api.get(STATISTICS, headers=person(platform, role).headers).json()["total"]
        return total["sequences"]

    assert (seen("participant"), seen("curator"), seen("administrator")) == (0, 0, 3)


def test_of_a_version_everybody_sees_all_but_the_voxels_of_test(
    api: httpx.Client, platform: Platform, lakes_and_farm: tuple[Person, list[str]]
) -> None:
    owner, (day, night, _farm) = lakes_and_farm
    name = dataset(platform, owner.user_id, {"train": [day], "test": [night]})
    headers = person(platform, "participant").headers
    shown = api.get(STATISTICS, params={"dataset": name}, headers=headers).json()
    train, test = shown["parts"]
    assert (train["key"], train["voxels_known"], train["voxels"]["traversable"]) == ("train", 1, 100)
    assert (test["key"], test["frames"], test["duration_s"], test["distance_m"]) == ("test", 3, 25.0, 30.5)
    assert (test["voxels"], test["class_ratios"], test["voxels_known"]) == (None, None, 0)
    assert shown["total"]["voxels_known"] == 1
    assert [half["voxels"] for half in shown["halves"] if half["key"] == "night"] == [None]


def test_a_version_that_was_never_published_is_not_found(api: httpx.Client, participant: Person) -> None:
    for path in ["", "/composition.png"]:
        answer = api.get(STATISTICS + path, params={"dataset": "nothing"}, headers=participant.headers)
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_the_figure_is_a_png_that_changes_with_what_it_shows(api: httpx.Client, platform: Platform) -> None:
    owner = person(platform, "curator")
    empty = api.get(f"{STATISTICS}/composition.png", headers=owner.headers)
    assert empty.headers["content-type"] == "image/png"
    published_sequence(platform, owner.user_id, environment="lake", illumination="night")
    filled = api.get(f"{STATISTICS}/composition.png", headers=owner.headers)
    assert filled.headers["etag"] != empty.headers["etag"]
    assert Image.open(io.BytesIO(filled.content)).size == (1320, 888)
    again = api.get(f"{STATISTICS}/composition.png", headers={**owner.headers, "If-None-Match": filled.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def share_of(png: bytes, colour: tuple[int, int, int], box: tuple[int, int, int, int]) -> float:
    """Of the pixels in the box (left, top, right, bottom), those of this colour."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB").crop(box))
    return float((pixels == np.array(colour)).all(axis=-1).mean())


def figure_of(entries: tuple[CatalogueEntry, ...]) -> bytes:
    record = statistics_record({"train": entries})
    return composition_png(record, figure_title(record["total"], "A dataset"))


def test_the_figure_shows_classes_by_their_share() -> None:
    """In panel b (top right) the bars of each class cover what it has of the occupied voxels."""
    png = figure_of((entry(1, voxels=(500, 250, 250)), entry(2, voxels=(500, 250, 250))))
    panel = (760, 60, 1300, 365)
    t, p, n = (share_of(png, rgb, panel) for rgb in CLASS_RGB.values())
    assert t / (t + p + n) == pytest.approx(0.5, abs=0.03)
    assert p / (t + p + n) == pytest.approx(0.25, abs=0.03)


@pytest.mark.whole
def test_equal_records_give_equal_figures_and_no_word_is_a_formula() -> None:
    entries = (*catalogue(9, 1), entry(90, environment="$\\frac{1}{0}$", illumination="$x", region="_$^"))
    assert figure_of(entries) == figure_of(entries)


def drive(platform: Platform, owner: Person, metres: list[float], **said: str) -> list[str]:
    """Sequences of 25 s at 1 m/s along one line: each begins at so many metres, a tenth of a second a decimetre."""
    ids = [driven(platform, owner, **said) for _ in metres]
    for one, begin_m in zip(ids, metres, strict=True):
        first_ns = 1_755_846_856_000_000_000 + int(begin_m * 1e9)
        places = [[0.0, begin_m, 0.0, 0.0], [24.9, begin_m + 24.9, 0.0, 0.0]]
        track = {"log": "", "vehicle": "n1", "map": "dataset:lake", "period_ns": 10**8, "speed_m_s": 1.0}
        track |= {"first_ns": first_ns, "last_ns": first_ns + 24_900_000_000, "places": places}
        with platform.database.transaction() as session:
            session.query(LabelSet).where(LabelSet.sequence_id == one).one().track = track
    return ids


def test_a_drive_is_put_whole_or_refused_by_its_name_and_the_gap_is_told(
    put: Put, api: httpx.Client, platform: Platform, curator: Person
) -> None:
    a, b, c = drive(platform, curator, [0.0, 25.0, 50.0], region="shore")
    (far,) = drive(platform, curator, [7575.0], region="pier")
    with platform.database.reading() as session:
        names = {one: session.get_one(SequenceRow, one).name for one in (a, b, c, far)}
    torn = put([a, c], [b], [far])
    assert (torn.status_code, codes(torn)) == (422, ["whole_drives"])
    (error,) = torn.json()["errors"]
    assert f"drive {names[a]!r} is divided" in error["detail"]
    assert f"2 in train ({names[a]}, {names[c]}) and 1 in val ({names[b]})" in error["detail"]
    shown = put([a, b], [], [far]).json()
    assert [one["drive"] for one in (*shown["train"], *shown["unassigned"], *shown["test"])] == [names[a]] * 3 + [""]
    gap = shown["gap"]
    assert (gap["distance_m"], gap["time_s"]) == (pytest.approx(7575 - 49.9), pytest.approx(7575 - 49.9))
    assert gap["nearest"] == gap["soonest"] == [names[b], names[far]]
    assert "at least 7525 m apart in place" in gap["message"]
    statistics = api.get(STATISTICS, headers=curator.headers).json()
    assert (statistics["total"]["sequences"], statistics["total"]["drives"]) == (4, 2)
    made = api.post(
        "/api/v1/datasets",
        json={"name": "of-drives", "reason": "why"},
        headers=person(platform, "administrator").headers,
    )
    assert made.status_code == 201, made.text
    manifest = api.get("/api/v1/datasets/of-drives/manifest", headers=curator.headers).json()
    assert {one["name"]: one["drive"] for one in manifest["sequences"]} == {
        names[a]: names[a], names[b]: names[a], names[far]: ""
    }  # fmt: skip
    assert manifest["gap"] == gap


def test_a_sequence_of_test_is_exposed_by_a_public_one_of_its_drive_and_leaving_out_what_links_them_does_not_help(
    put: Put, platform: Platform, curator: Person
) -> None:
    a, _, c = drive(platform, curator, [0.0, 25.0, 50.0])
    with platform.database.transaction() as session:
        row = session.get_one(SequenceRow, a)
        row.is_public, name = True, row.name
    found = {one["code"]: one for one in put([], [], [c]).json()["findings"]}["test_is_public"]
    assert f"{name!r} of the same drive is public" in found["message"]
    assert "whole_drives" in codes(put([a], [], [c]))
