"""A sequence whose labels anybody may have is not put into test unseen, and what is in test is not made public."""

from collections.abc import Callable
from hashlib import sha256
from typing import Any

import httpx
import pytest

from services.domain.benchmarks.phases.findings import findings_of
from services.domain.datasets.queries import dataset_named
from services.runtime.orm import Phase, Recording, RecordingFile, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds import made
from testing.worlds.published import published_sequence
from tests.services.domain.benchmarks import laid

URL = "/api/v1/sequences"
SPLITS = "/api/v1/splits"
CODE = "test_is_public"
Change = Callable[..., httpx.Response]


@pytest.fixture
def ids(platform_on: Platform, curator_on: Person) -> dict[str, str]:
    """A labelled sequence for each part, in a region of its own."""
    said = {"environment": "lake", "illumination": "day"}
    parts = ("train", "val", "test")
    return {part: published_sequence(platform_on, curator_on.user_id, region=f"of {part}", **said) for part in parts}


@pytest.fixture
def curator_on(platform_on: Platform) -> Person:
    return person(platform_on, "curator")


@pytest.fixture
def root(platform_on: Platform) -> Person:
    return person(platform_on, "administrator")


@pytest.fixture
def change(api_on: httpx.Client, curator_on: Person) -> Change:
    def asked(sequence_id: str, **body: Any) -> httpx.Response:
        headers = {**curator_on.headers, "If-Match": "*"}
        return api_on.patch(f"{URL}/{sequence_id}", json=body, headers=headers)

    return asked


def put(api: httpx.Client, root: Person, ids: dict[str, str]) -> httpx.Response:
    body = {part: [one] for part, one in ids.items()} | {"reason": "why"}
    answer = api.put(SPLITS, json=body, headers={**root.headers, "If-Match": "*"})
    assert answer.status_code == 200, answer.text
    return answer


def exposed(answer: httpx.Response) -> list[dict[str, Any]]:
    return [one for one in answer.json()["findings"] if one["code"] == CODE]


def published(api: httpx.Client, root: Person, name: str = "stone-1.0") -> httpx.Response:
    answer = api.post("/api/v1/datasets", json={"name": name, "reason": "release"}, headers=root.headers)
    assert answer.status_code == 201, answer.text
    return answer


def test_what_was_public_is_told_when_it_is_put_into_test_published_and_scored(
    api_on: httpx.Client, platform_on: Platform, root: Person, ids: dict[str, str], change: Change
) -> None:
    """The attack: make a sequence public, fetch its labels, hide it again, and wait until it is the hidden truth."""
    for is_public in (True, False):
        assert change(ids["test"], is_public=is_public).status_code == 200
    (finding,) = exposed(put(api_on, root, ids))
    assert (finding["severity"], finding["sequence_ids"]) == ("warning", [ids["test"]])
    assert "is in test and its labels may be known: it was public from 20" in finding["message"]
    judged = api_on.post(f"{SPLITS}/verdicts", json={part: [one] for part, one in ids.items()}, headers=root.headers)
    assert exposed(judged) == [finding]
    assert exposed(published(api_on, root)) == [finding]
    log = api_on.get("/api/v1/admin/audit-log", headers=root.headers).json()["items"]
    assert CODE in next(line["facts"]["warnings"] for line in log if line["act"] == "dataset.create")
    codes = phase_codes(platform_on, root)
    assert codes == ["labels_were_public"]


def phase_codes(platform: Platform, root: Person, name: str = "stone-1.0") -> list[str]:
    with platform.database.reading() as session:
        dataset = dataset_named(session, name)
    assert dataset is not None
    phase = laid.phase(platform, root, dataset)
    with platform.database.reading() as session:
        return [finding.code for finding in findings_of(session, session.get_one(Phase, phase.id))]


def test_what_is_public_is_told(api_on: httpx.Client, root: Person, ids: dict[str, str], change: Change) -> None:
    assert exposed(put(api_on, root, ids)) == []
    assert change(ids["train"], is_public=True).status_code == 200
    turned = {"train": ids["test"], "val": ids["val"], "test": ids["train"]}
    (finding,) = exposed(put(api_on, root, turned))
    assert finding["message"].endswith("it is public")


def test_what_a_version_gave_out_is_told(api_on: httpx.Client, root: Person, ids: dict[str, str]) -> None:
    put(api_on, root, ids)
    assert exposed(published(api_on, root)) == []
    turned = {"train": ids["val"], "val": ids["test"], "test": ids["train"]}
    (finding,) = exposed(put(api_on, root, turned))
    assert finding["message"].endswith("it is in train of version 'stone-1.0'")


def test_the_same_bag_under_another_name_is_told_though_the_public_one_is_deleted(
    api_on: httpx.Client, platform_on: Platform, root: Person, curator_on: Person, ids: dict[str, str], change: Change
) -> None:
    with platform_on.database.transaction() as session:
        first = SequenceRow(owner_id=curator_on.user_id, name="first")
        session.add(first)
        session.flush()
        first_id = first.id
    made.upload(platform_on, curator_on, b"one bag", target_id=first_id, state="consumed")
    assert change(first_id, is_public=True).status_code == 200
    again = made.upload(platform_on, curator_on, b"one bag", target_id=ids["test"], state="consumed")
    with platform_on.database.transaction() as session:
        whole = Recording(sequence_id=ids["test"], filename="run.mcap", size_bytes=7, sha256="ab" * 32)
        digest = sha256(b"one bag").hexdigest()
        whole.files = [RecordingFile(ordinal=0, upload_id=again, filename="run.mcap", size_bytes=7, sha256=digest)]
        session.add(whole)
    headers = {**curator_on.headers, "If-Match": "*"}
    assert api_on.delete(f"{URL}/{first_id}", headers=headers).status_code == 204
    (finding,) = exposed(put(api_on, root, ids))
    assert finding["message"].endswith("it has a file of 'first', which is or was public")


def test_what_is_in_test_is_not_made_public_and_the_refusal_says_which_and_where(
    api_on: httpx.Client, root: Person, ids: dict[str, str], change: Change
) -> None:
    put(api_on, root, ids)
    name = api_on.get(f"{URL}/{ids['test']}", headers=root.headers).json()["name"]
    refused = change(ids["test"], is_public=True)
    assert (refused.status_code, refused.json()["code"]) == (409, "hidden_truth")
    assert f"sequence '{name}' is in test of the splits under discussion" in refused.json()["detail"]
    assert "make another sequence public, or take this one out of test" in refused.json()["detail"]
    assert [change(ids[part], is_public=True).status_code for part in ("train", "val")] == [200, 200]
    published(api_on, root)
    assert "in test of version 'stone-1.0'" in change(ids["test"], is_public=True).json()["detail"]


def test_whatever_makes_a_sequence_public_is_remembered(platform_on: Platform, curator_on: Person) -> None:
    """Catches alone a new way to make sequences public that leaves no trace of it."""
    with platform_on.database.transaction() as session:
        born, made_so = (
            SequenceRow(owner_id=curator_on.user_id, name=name, is_public=name == "born") for name in ("born", "later")
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
