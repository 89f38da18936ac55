"""Sequences: made, seen, changed and deleted; what a list costs; what anybody may have is not put into test unseen."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from hashlib import sha256
from typing import Any

import httpx
import pytest
from sqlalchemy import event, update

from api.deps import VISITOR
from api.views.sequences import sequence_detail, sequence_items, shown_sequence_detail
from services.domain.benchmarks.phases.findings import findings_of
from services.domain.datasets.queries import dataset_named
from services.runtime.database.inserts import insert_new
from services.runtime.orm import LabelSet, Phase, Recording, RecordingFile, SequenceRow, SplitMember
from services.runtime.platform import Platform
from testing.api.serving import Person, at_once, person
from testing.worlds import made
from testing.worlds.made import labels, row_of, run, sequence, upload
from testing.worlds.published import published_sequence
from tests.services.domain.benchmarks import laid

URL = "/api/v1/sequences"
FACTS = {"environment": "mountain", "illumination": "day", "region": "Gyeonggi", "platform": "warthog-1"}


def code_of(answer: httpx.Response) -> str:
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    return str(answer.json()["code"])


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator, "forest", **FACTS)


@pytest.fixture
def other(platform: Platform) -> Person:
    return person(platform, "curator")


def test_a_visitor_is_shown_what_is_public_and_asked_to_sign_in_for_the_rest(
    api: httpx.Client, curator: Person, other: Person
) -> None:
    made = [api.post(URL, json={"name": name}, headers=curator.headers).json() for name in ("open", "closed")]
    shown = api.patch(
        f"{URL}/{made[0]['id']}", json={"is_public": True}, headers={**curator.headers, "If-Match": '"1"'}
    )
    assert shown.json()["is_public"] is True
    for looking in ({}, other.headers):
        assert [item["name"] for item in api.get(URL, headers=looking).json()["items"]] == ["open"]
        assert api.get(f"{URL}/{made[0]['id']}", headers=looking).status_code == 200
    assert api.get(f"{URL}/{made[1]['id']}").status_code == 401
    assert api.get(f"{URL}/{made[1]['id']}", headers=other.headers).status_code == 404
    change = {"json": {"region": "x"}, "headers": {**other.headers, "If-Match": '"2"'}}
    assert api.patch(f"{URL}/{made[0]['id']}", **change).status_code == 404


def test_a_word_that_is_not_the_datasets_is_refused_with_those_that_are(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any]
) -> None:
    for method in ["POST", "PATCH"]:
        for said, code, allowed in [
            ({"environment": "Forest"}, "unknown_environment", "farmland, mountain, lake, construction"),
            (
                {"illumination": "Day"},
                "unknown_illumination",
                "day, sunny, overcast, dawn, dusk, night, moonlit, floodlit",
            ),
            ({"region": "Gyeong gi"}, "bad_region", "letters, digits, dots, dashes"),
        ]:
            path = URL if method == "POST" else f"{URL}/{forest['id']}"
            headers = {**curator.headers, "If-Match": "*"}
            answer = api.request(method, path, json={"name": "other", **said}, headers=headers)
            (error,) = answer.json()["errors"]
            assert (answer.status_code, error["code"]) == (422, code)
            assert error["where"] == f"body.{next(iter(said))}"
            assert allowed in error["detail"]


def test_a_name_is_an_owners_own_once(api: httpx.Client, platform: Platform) -> None:
    ada, bob = person(platform, "curator"), person(platform, "curator")
    sequence(api, ada, "forest")
    sequence(api, bob, "forest")
    again = api.post(URL, json={"name": "forest"}, headers=ada.headers)
    assert (again.status_code, code_of(again)) == (409, "name_taken")


def test_of_several_that_take_a_name_at_once_one_gets_it(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    url = str(api_on.base_url)
    answers = at_once(url, 4, lambda api, _: api.post(URL, json={"name": "x"}, headers=ada.headers).status_code)
    assert sorted(answers) == [201, 409, 409, 409]
    assert len(api_on.get(URL, headers=ada.headers).json()["items"]) == 1


def test_a_change_says_which_state_it_means(api: httpx.Client, curator: Person, forest: Mapping[str, Any]) -> None:
    for method in ["PATCH", "DELETE"]:
        path = f"{URL}/{forest['id']}"
        missing = api.request(method, path, json={}, headers=curator.headers)
        stale = api.request(method, path, json={}, headers=curator.headers | {"If-Match": '"99"'})
        assert (missing.status_code, code_of(missing)) == (428, "precondition_required")
        assert (stale.status_code, code_of(stale)) == (412, "precondition_failed")
        assert api.get(path, headers=curator.headers).json() == forest


def test_a_sequence_with_labels_keeps_its_name(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    labels(platform, forest)
    match = curator.headers | {"If-Match": "*"}
    renamed = api.patch(f"{URL}/{forest['id']}", json={"name": "wood"}, headers=match)
    assert (renamed.status_code, code_of(renamed)) == (409, "conflict")
    assert api.patch(f"{URL}/{forest['id']}", json={"region": "X"}, headers=match).json()["region"] == "X"


def test_a_sequence_is_made_shown_and_listed(api: httpx.Client, curator: Person, administrator: Person) -> None:
    answer = api.post(URL, json={"name": "forest", **FACTS}, headers=curator.headers)
    made = answer.json()
    assert answer.status_code == 201
    assert answer.headers["location"] == f"{URL}/{made['id']}"
    assert answer.headers["etag"] == '"1"'
    assert {key: made[key] for key in FACTS} == FACTS
    assert (made["owner_id"], made["recordings"], made["job"], made["labels"]) == (curator.user_id, 0, None, None)
    assert made["created_at"].endswith("Z")
    assert api.get(answer.headers["location"], headers=curator.headers).json() == made
    assert [item["id"] for item in api.get(URL, headers=administrator.headers).json()["items"]] == [made["id"]]


def test_a_prefix_of_names_is_no_pattern(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    for name in ("wood-1", "Wood-3", "hill_1", "hill-1"):
        sequence(api_on, ada, name)
    for prefix, names in {
        "wood": ["wood-1"],
        "hill_": ["hill_1"],
        "%": [],
        "": ["hill-1", "hill_1", "Wood-3", "wood-1"],
    }.items():
        items = api_on.get(URL, params={"name": prefix} if prefix else {}, headers=ada.headers).json()["items"]
        assert [item["name"] for item in items] == names, prefix


def test_a_deleted_sequence_is_gone_with_all_that_hangs_on_it(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    made = sequence(api, ada)
    labels(platform, made)
    upload_id = upload(platform, ada)
    added = api.post(f"{URL}/{made['id']}/recordings", json={"upload_id": upload_id}, headers=ada.headers).json()
    run_id = run(platform, ada, "ingest.ok", "labeler.ok", sequence_id=made["id"])
    gone = api.delete(f"{URL}/{made['id']}", headers=ada.headers | {"If-Match": "*"})
    assert (gone.status_code, gone.content) == (204, b"")
    for path in ("", "/recordings", "/report", "/frames", "/mesh", "/previews/bev.png"):
        assert api.get(f"{URL}/{made['id']}{path}", headers=ada.headers).status_code == 404
    again = api.delete(f"{URL}/{made['id']}", headers=ada.headers | {"If-Match": "*"})
    assert again.status_code == 404
    for job_id in (added["job"]["id"], run_id):
        assert row_of(platform, job_id).state == "cancelled"
    with platform.database.reading() as session:
        assert session.query(LabelSet).count() == session.query(Recording).count() == 0
        assert session.get_one(SequenceRow, made["id"]).deleted_ns
    assert sequence(api, ada)["id"] != made["id"], "its name is free again"


def test_what_is_done_to_a_sequence_is_in_the_audit_log(
    api: httpx.Client, curator: Person, administrator: Person, forest: Mapping[str, Any]
) -> None:
    match = curator.headers | {"If-Match": "*"}
    api.patch(f"{URL}/{forest['id']}", json={"region": "A"}, headers=match)
    api.delete(f"{URL}/{forest['id']}", headers=match)
    lines = api.get("/api/v1/admin/audit-log", headers=administrator.headers).json()["items"]
    acts = {line["act"] for line in lines if line["subject_id"] == forest["id"]}
    assert acts == {"sequence.create", "sequence.change", "sequence.delete"}


def listed(api: httpx.Client, who: Person) -> dict[str, dict[str, Any]]:
    return {item["name"]: item for item in api.get(URL, headers=who.headers).json()["items"]}


def put_into(platform: Platform, part: str, *ids: str) -> None:
    with platform.database.transaction() as session:
        insert_new(session, SplitMember, [{"sequence_id": one, "part": part} for one in ids])


@pytest.mark.parametrize("count", [1, 7])
def test_sequences_are_two_statements_beside_their_own_however_many_they_are(
    api: httpx.Client, platform: Platform, curator: Person, count: int
) -> None:
    for number in range(count):
        labels(platform, sequence(api, curator, f"forest-{number}"), seed=bytes([number]))
    said: list[str] = []
    with platform.database.reading() as session:
        rows = list(session.query(SequenceRow))
        event.listen(session.get_bind(), "before_cursor_execute", lambda *given: said.append(given[2]))
        owner = VISITOR.__class__(curator.user_id, "", "curator", frozenset({"read"}), is_session=False)
        assert len(sequence_items(session, rows, owner)) == count
    assert len(said) == 2, said


def test_a_sequence_is_said_by_itself_as_in_a_list_and_as_its_pages_say_it(
    api: httpx.Client, platform: Platform
) -> None:
    """To its owner and, as it is public, to another; with labels and without."""
    ada, other = person(platform, "curator"), person(platform, "curator")
    made = [sequence(api, ada, name) for name in ("labelled", "bare")]
    labels(platform, made[0])
    put_into(platform, "val", *(one["id"] for one in made))
    with platform.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))
    for who, split in ((ada, "val"), (other, None)):
        for one in made:
            said = api.get(f"{URL}/{one['id']}", headers=who.headers).json()
            assert listed(api, who)[one["name"]].items() <= said.items()
            caller = replace(VISITOR, user_id=who.user_id, role="curator")
            with platform.database.reading() as session:
                detail = sequence_detail(session, session.get_one(SequenceRow, one["id"]), caller)
            assert (said, said["split"]) == (detail.model_dump(mode="json"), split)


def test_a_sequence_is_read_by_two_statements_and_its_labels_by_three_more(
    api: httpx.Client, platform: Platform
) -> None:
    """Of somebody else's; to its owner it is said too which recordings were added later."""
    ada, other = person(platform, "curator"), person(platform, "curator")
    made = [sequence(api, ada, name) for name in ("bare", "labelled")]
    labels(platform, made[1])
    with platform.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))
    counts, statements = [], list[str]()
    event.listen(platform.database.engine, "before_cursor_execute", lambda _c, _k, text, *_: statements.append(text))
    caller = replace(VISITOR, user_id=other.user_id, role="curator")
    for one in made:
        statements.clear()
        with platform.database.reading() as session:
            shown_sequence_detail(session, caller, one["id"])
        counts.append(len([text for text in statements if text.lstrip().startswith(("SELECT", "WITH"))]))
    assert counts == [2, 5], statements


SPLITS = "/api/v1/splits"
CODE = "test_is_public"
Change = Callable[..., httpx.Response]


@pytest.fixture
def ids(platform: Platform, curator: Person) -> dict[str, str]:
    """A labelled sequence for each part, in a region of its own."""
    said = {"environment": "lake", "illumination": "day"}
    parts = ("train", "val", "test")
    return {part: published_sequence(platform, curator.user_id, region=f"of {part}", **said) for part in parts}


@pytest.fixture
def change(api: httpx.Client, curator: Person) -> Change:
    def asked(sequence_id: str, **body: Any) -> httpx.Response:
        headers = {**curator.headers, "If-Match": "*"}
        return api.patch(f"{URL}/{sequence_id}", json=body, headers=headers)

    return asked


def put(api: httpx.Client, administrator: Person, ids: dict[str, str]) -> httpx.Response:
    body = {part: [one] for part, one in ids.items()} | {"reason": "why"}
    answer = api.put(SPLITS, json=body, headers={**administrator.headers, "If-Match": "*"})
    assert answer.status_code == 200, answer.text
    return answer


def exposed_in(answer: httpx.Response) -> list[dict[str, Any]]:
    return [one for one in answer.json()["findings"] if one["code"] == CODE]


def published(api: httpx.Client, administrator: Person, name: str = "stone-1.0") -> httpx.Response:
    answer = api.post("/api/v1/datasets", json={"name": name, "reason": "release"}, headers=administrator.headers)
    assert answer.status_code == 201, answer.text
    return answer


def test_what_was_public_is_told_when_it_is_put_into_test_published_and_scored(
    api: httpx.Client, platform: Platform, administrator: Person, ids: dict[str, str], change: Change
) -> None:
    """The attack: make a sequence public, fetch its labels, hide it again, and wait until it is the hidden truth."""
    for is_public in (True, False):
        assert change(ids["test"], is_public=is_public).status_code == 200
    (finding,) = exposed_in(put(api, administrator, ids))
    assert (finding["severity"], finding["sequence_ids"]) == ("warning", [ids["test"]])
    assert "is in test, and its labels may be known: it was public from 20" in finding["message"]
    judged = api.post(
        f"{SPLITS}/verdicts", json={part: [one] for part, one in ids.items()}, headers=administrator.headers
    )
    assert exposed_in(judged) == [finding]
    assert exposed_in(published(api, administrator)) == [finding]
    log = api.get("/api/v1/admin/audit-log", headers=administrator.headers).json()["items"]
    assert CODE in next(line["facts"]["warnings"] for line in log if line["act"] == "dataset.create")
    codes = phase_codes(platform, administrator)
    assert codes == ["labels_were_public"]


def phase_codes(platform: Platform, administrator: Person, name: str = "stone-1.0") -> list[str]:
    with platform.database.reading() as session:
        dataset = dataset_named(session, name)
    assert dataset is not None
    phase = laid.phase(platform, administrator, dataset)
    with platform.database.reading() as session:
        return [finding.code for finding in findings_of(session, session.get_one(Phase, phase.id))]


def test_what_is_public_is_told(api: httpx.Client, administrator: Person, ids: dict[str, str], change: Change) -> None:
    assert exposed_in(put(api, administrator, ids)) == []
    assert change(ids["train"], is_public=True).status_code == 200
    turned = {"train": ids["test"], "val": ids["val"], "test": ids["train"]}
    (finding,) = exposed_in(put(api, administrator, turned))
    assert finding["message"].endswith("it is public")


def test_what_a_version_gave_out_is_told(api: httpx.Client, administrator: Person, ids: dict[str, str]) -> None:
    put(api, administrator, ids)
    assert exposed_in(published(api, administrator)) == []
    turned = {"train": ids["val"], "val": ids["test"], "test": ids["train"]}
    (finding,) = exposed_in(put(api, administrator, turned))
    assert finding["message"].endswith("it is in train of version 'stone-1.0'")


def test_the_same_bag_under_another_name_is_told_though_the_public_one_is_deleted(
    api: httpx.Client, platform: Platform, administrator: Person, curator: Person, ids: dict[str, str], change: Change
) -> None:
    with platform.database.transaction() as session:
        first = SequenceRow(owner_id=curator.user_id, name="first")
        session.add(first)
        session.flush()
        first_id = first.id
    made.upload(platform, curator, b"one bag", target_id=first_id, state="consumed")
    assert change(first_id, is_public=True).status_code == 200
    again = made.upload(platform, curator, b"one bag", target_id=ids["test"], state="consumed")
    with platform.database.transaction() as session:
        whole = Recording(sequence_id=ids["test"], filename="run.mcap", size_bytes=7, sha256="ab" * 32)
        digest = sha256(b"one bag").hexdigest()
        whole.files = [RecordingFile(ordinal=0, upload_id=again, filename="run.mcap", size_bytes=7, sha256=digest)]
        session.add(whole)
    headers = {**curator.headers, "If-Match": "*"}
    assert api.delete(f"{URL}/{first_id}", headers=headers).status_code == 204
    (finding,) = exposed_in(put(api, administrator, ids))
    assert finding["message"].endswith("it shares a file with 'first', which is or was public")


def test_what_is_in_test_is_not_made_public_and_the_refusal_says_which_and_where(
    api: httpx.Client, administrator: Person, ids: dict[str, str], change: Change
) -> None:
    put(api, administrator, ids)
    name = api.get(f"{URL}/{ids['test']}", headers=administrator.headers).json()["name"]
    refused = change(ids["test"], is_public=True)
    assert (refused.status_code, refused.json()["code"]) == (409, "hidden_truth")
    assert f"sequence '{name}' is in test of the draft splits" in refused.json()["detail"]
    assert "Make another sequence public, or remove this sequence from test" in refused.json()["detail"]
    assert [change(ids[part], is_public=True).status_code for part in ("train", "val")] == [200, 200]
    published(api, administrator)
    assert "in test of version 'stone-1.0'" in change(ids["test"], is_public=True).json()["detail"]


def test_whatever_makes_a_sequence_public_is_remembered(platform: Platform, curator: Person) -> None:
    """Catches alone a new way to make sequences public that leaves no trace of it."""
    with platform.database.transaction() as session:
        born, made_so = (
            SequenceRow(owner_id=curator.user_id, name=name, is_public=name == "born") for name in ("born", "later")
        )
        made_so.is_public = True
        session.add_all([born, made_so])
        session.flush()
        kept = [one.published_ns for one in (born, made_so)]
        for one in (born, made_so):
            one.is_public = False
            one.is_public = True
        assert None not in kept
        assert [one.published_ns for one in (born, made_so)] == kept
