"""Sequences edited, cancelled and deleted by command; label sets activated; a token shown and given back."""

import json
from collections.abc import Mapping
from typing import Any

import pytest

from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, SequenceRow
from services.runtime.platform import Platform
from stone_client.credentials import read_credentials, remember
from testing.api.serving import Person, client_of, person
from testing.worlds import made
from tests.stone_client.participating import answered, refused, stone


@pytest.fixture
def forest(platform: Platform, as_owner: str, owner: Person) -> Mapping[str, Any]:
    with client_of(platform) as api:
        return made.sequence(api, owner, "forest")


@pytest.fixture
def sequence(forest: Mapping[str, Any]) -> str:
    return str(forest["id"])


def test_a_sequence_is_edited(platform: Platform, sequence: str) -> None:
    assert answered("sequence", "edit", "forest", "--region", "Lake-1", "--illumination", "dusk")["region"] == "Lake-1"
    assert answered("sequence", "edit", sequence, "--public")["is_public"]
    assert not answered("sequence", "edit", "forest", "--private", "--name", "wood")["is_public"]
    with platform.database.reading() as session:
        row = session.get_one(SequenceRow, sequence)
        assert (row.name, row.region, row.illumination, row.is_public) == ("wood", "Lake-1", "dusk", False)
    assert stone("sequence", "edit", "wood").exit_code == 2
    assert refused(stone("sequence", "edit", "wood", "--illumination", "noon")) == "invalid_request"


def test_a_sequence_is_deleted_with_consent(platform: Platform, sequence: str, forest: Mapping[str, Any]) -> None:
    made.labels(platform, forest, seed=b"1")
    shown = answered("sequence", "delete", "forest", "--dry-run")
    assert (shown["id"], shown["label_sets"]) == (sequence, 1)
    result = stone("sequence", "delete", "forest", stdin="y\n")
    assert (result.exit_code, sequence in result.stderr) == (2, True)
    with platform.database.reading() as session:
        assert session.get(SequenceRow, sequence) is not None
    assert answered("sequence", "delete", "forest", "--yes") == {"deleted": sequence}
    assert refused(stone("sequence", "status", "forest")) == "not_found"


def test_an_older_label_set_is_activated(platform: Platform, forest: Mapping[str, Any]) -> None:
    older, newer = (made.labels(platform, forest, seed=seed).id for seed in (b"1", b"2"))

    def active() -> list[str]:
        sets = answered("label-set", "list", "forest")["label_sets"]
        return [one["id"] for one in sets if one["is_counting"]]

    assert active() == [newer]
    assert answered("label-set", "activate", "forest", "latest~1")["id"] == older
    assert active() == [older]
    assert refused(stone("label-set", "activate", "forest", "latest~9")) == "no_label_set"


def test_a_run_is_cancelled(platform: Platform, sequence: str, owner: Person) -> None:
    with platform.database.transaction() as session:
        run = enqueue_run(session, "sequence.process", [JobSpec("labeler.publish")], Context(owner.user_id, sequence))
        run_id = run.id
    assert answered("sequence", "cancel", "forest", "--reason", "wrong calibration")["id"] == run_id
    with platform.database.reading() as session:
        job = session.get_one(Job, run_id)
        assert (job.state, job.cancel_reason) == ("cancelled", "wrong calibration")
    assert refused(stone("sequence", "cancel", "meadow")) == "not_found"


def test_the_token_is_shown_revoked_and_forgotten(
    platform: Platform, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ada = person(platform, "curator", "ada")
    remember(url, ada.secret, as_default=True)
    remember("http://127.0.0.1:9", "stone_other", as_default=False)
    shown = answered("auth", "status")
    assert (shown["url"], shown["name"], shown["role"]) == (url, ada.name, "curator")
    assert shown["expires_at"]
    assert ada.secret not in stone("auth", "status").stdout
    assert [one["url"] for one in answered("auth", "status", "--all")["servers"]] == sorted([url, "http://127.0.0.1:9"])
    assert answered("auth", "logout") == {"url": url, "is_revoked": True}
    known = read_credentials()
    assert (known.default, list(known.token_of)) == ("", ["http://127.0.0.1:9"]), "no other server is meant silently"
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", ada.secret)
    assert refused(stone("auth", "status")) == "unauthenticated"
    monkeypatch.delenv("STONE_URL")
    assert refused(stone("auth", "logout")) == "not_signed_in"


def test_a_token_that_ended_or_a_server_that_is_away_keeps_nobody_signed_in(url: str) -> None:
    remember(url, "stone_ended", as_default=True)
    assert answered("auth", "logout") == {"url": url, "is_revoked": False}
    remember("http://127.0.0.1:9", "stone_other", as_default=True)
    assert json.loads(stone("auth", "logout", "--local", "--json").stdout)["is_revoked"] is False
    assert read_credentials().token_of == {}
