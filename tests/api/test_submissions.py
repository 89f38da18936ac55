"""Submissions over HTTP: whose they are, what is refused and how, and the whole way from a zip to its verdict."""

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from services.domain.benchmarks.submissions.submissions import settle
from services.runtime.orm import AuditEntry, User
from services.runtime.platform import Platform
from testing.api.serving import person
from testing.worlds.made import NOBODY
from tests.api.submitting import URL, Submitting, answered, as_entrant, refused, submitting
from tests.api.test_events import listen
from tests.services.domain.benchmarks.drafts import another_entrant, entrant_on

ACTS = ("cancel", "withdraw")


def test_what_is_announced_is_shown_and_found_again(api_on: httpx.Client, platform_on: Platform) -> None:
    team = submitting(api_on, platform_on)
    reply = team.announce(description="Two\nlines", headers={"Idempotency-Key": "once"})
    draft = answered(reply, 201)
    assert reply.headers["Location"] == f"{URL}/submissions/{draft['id']}"
    assert reply.headers["ETag"] == '"1"'
    assert (draft["state"], draft["kind"], draft["description"]) == ("draft", "entry", "Two\nlines")
    again = team.announce(description="Two\nlines", headers={"Idempotency-Key": "once"})
    assert (again.status_code, again.json()["id"]) == (201, draft["id"])
    assert again.headers["Idempotency-Replayed"] == "true"
    assert team.shown(draft["id"]) == draft
    upload_id = team.upload(draft)
    assert team.shown(draft["id"])["upload_id"] == upload_id
    reply = team.finalize(draft["id"], upload_id)
    queued = answered(reply, 202)
    assert (queued["state"], queued["queue_position"], queued["progress"]) == ("queued", 0, {"done": 0, "total": 1})
    assert reply.headers["Location"] == f"{URL}/jobs/{queued['job_id']}"
    assert answered(team.api.get(reply.headers["Location"], headers=team.caller.headers), 200)["state"] == "queued"
    with platform_on.database.reading() as session:
        acts = session.scalars(select(AuditEntry.act).where(AuditEntry.subject_id == draft["id"]))
        assert list(acts.all()) == ["submission.announce", "submission.finalize"]


def test_a_second_submission_waits_behind_the_first(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    first, second = team.submitted(), team.submitted()
    assert [team.shown(one["id"])["queue_position"] for one in (first, second)] == [0, 1]
    answered(team.post(f"{first['id']}/cancel", {"reason": "wrong weights"}), 200)
    assert team.shown(second["id"])["queue_position"] == 0


@pytest.mark.parametrize("what", ["submissions", "validations"])
def test_nobody_announces_for_a_team_of_others(api: httpx.Client, platform: Platform, what: str) -> None:
    team = submitting(api, platform)
    other = as_entrant(api, another_entrant(entrant_on(platform).place))
    strangers = (other, Submitting(api, person(platform, "administrator"), "", ""))
    for stranger in strangers:
        theirs = Submitting(api, stranger.caller, team.phase_id, team.team_id)
        assert refused(theirs.announce(where=what)) == (404, "not_found")
    reader = person(platform, "participant", scopes=["read"])
    assert refused(Submitting(api, reader, team.phase_id, team.team_id).announce(where=what)) == (403, "forbidden")
    assert refused(Submitting(api, team.caller, NOBODY, team.team_id).announce(where=what)) == (404, "not_found")


def test_a_submission_of_others_does_not_exist(api: httpx.Client, platform: Platform) -> None:
    entrant = entrant_on(platform)
    team, other = as_entrant(api, entrant), as_entrant(api, another_entrant(entrant.place))
    submission_id = team.submitted()["id"]
    for path in ("", "/validation-report", "/events"):
        for one in (submission_id, NOBODY):
            assert refused(other.read(f"submissions/{one}{path}")) == (404, "not_found")
    for act in ACTS:
        assert refused(other.post(f"{submission_id}/{act}")) == (404, "not_found")
    assert refused(other.finalize(submission_id, NOBODY)) == (404, "not_found")
    changed = api.patch(f"{URL}/submissions/{submission_id}", json={"method": "x"}, headers=other.caller.headers)
    assert refused(changed) == (404, "not_found")
    assert answered(other.read("submissions"), 200)["items"] == []
    assert refused(other.read(f"phases/{team.phase_id}/teams/{team.team_id}/quota")) == (404, "not_found")
    administrator = Submitting(api, person(platform, "administrator"), team.phase_id, team.team_id)
    assert administrator.shown(submission_id)["id"] == submission_id
    assert administrator.quota()["reserved"] == 1


@pytest.mark.parametrize(
    ("said", "code"),
    [
        ({"sha256": "0" * 63}, "string_pattern_mismatch"),
        ({"size_bytes": 0}, "greater_than_equal"),
        ({"modality": "L+C"}, "literal_error"),
        ({"method": "a\u202eb"}, "string_pattern_mismatch"),
        ({"method": " "}, "string_too_short"),
        ({"description": "x" * 20_001}, "string_too_long"),
        ({"description": "bell\x07"}, "string_pattern_mismatch"),
        ({"kind": "validation"}, "literal_error"),
        ({"state": "scored"}, "extra_forbidden"),
    ],
)
def test_what_is_said_of_a_submission_is_checked(
    api: httpx.Client, platform: Platform, said: dict[str, Any], code: str
) -> None:
    reply = submitting(api, platform).announce(**said)
    assert refused(reply) == (422, "invalid_request")
    assert [one["code"] for one in reply.json()["errors"]] == [code]


def test_a_baseline_is_for_curators(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    assert refused(team.announce(kind="baseline")) == (403, "forbidden")
    with platform.database.transaction() as session:
        session.get_one(User, team.caller.user_id).role = "curator"
    assert team.announced(kind="baseline")["kind"] == "baseline"


def test_a_quota_that_is_used_up_says_when_the_next_is_free(api_on: httpx.Client, platform_on: Platform) -> None:
    team = submitting(api_on, platform_on, scorings_per_window=1)
    team.submitted()
    draft = team.announced()
    upload_id = team.upload(draft)
    reply = team.finalize(draft["id"], upload_id)
    assert refused(reply) == (429, "scorings_exhausted")
    week_s = timedelta(days=7).total_seconds()
    assert week_s - 60 < int(reply.headers["Retry-After"]) <= week_s
    next_at = datetime.fromisoformat(reply.json()["next_slot_at"])
    assert timedelta(days=6) < next_at - datetime.now(UTC) <= timedelta(days=7)
    quota = team.quota()
    assert (quota["limit"], quota["used"], quota["reserved"], quota["next_slot_at"]) == (
        1, 0, 1, reply.json()["next_slot_at"]
    )  # fmt: skip
    assert team.shown(draft["id"])["state"] == "draft"


def test_without_any_scoring_left_there_is_no_time_to_wait_for(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform, scorings_total=0)
    draft = team.announced()
    reply = team.finalize(draft["id"], team.upload(draft))
    assert refused(reply) == (429, "scorings_exhausted")
    assert reply.headers["Retry-After"] == "86400"  # so that no client asks again and again meanwhile
    assert "next_slot_at" not in reply.json()
    assert (team.quota()["total_left"], team.quota()["next_slot_at"]) == (0, None)


def test_validations_cost_no_scoring_and_are_bounded_by_the_day(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform, scorings_total=0, validations_per_day=1)
    assert team.submitted(where="validations")["kind"] == "validation"
    reply = team.announce(where="validations")
    assert refused(reply) == (429, "validations_exhausted")
    assert 86_300 < int(reply.headers["Retry-After"]) <= 86_400
    assert (team.quota()["validations_left"], team.quota()["reserved"]) == (0, 0)


def test_lists_are_filtered_and_paged(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    drafts = [team.announced()["id"] for _ in range(3)]
    queued = team.submitted()["id"]
    checked = team.announced(where="validations")["id"]
    for query, expected in {
        "": [checked, queued, *reversed(drafts)],
        "state=queued": [queued],
        "kind=validation": [checked],
        f"team_id={team.team_id}&phase_id={team.phase_id}&state=draft&kind=entry": [*reversed(drafts)],
        f"team_id={NOBODY}": [],
    }.items():
        found = answered(team.read(f"submissions?{query}"), 200)["items"]
        assert [one["id"] for one in found] == expected
    first = answered(team.read("submissions?limit=3"), 200)
    rest = answered(team.read(f"submissions?limit=3&cursor={first['next']}"), 200)
    assert [one["id"] for one in (*first["items"], *rest["items"])] == [checked, queued, *reversed(drafts)]
    assert rest["next"] is None


def test_the_page_of_a_method_is_changed_by_who_has_read_it(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    submission_id = team.submitted()["id"]
    where, headers = f"{URL}/submissions/{submission_id}", team.caller.headers
    said = {"method": "Net v2", "description": "More\ndata."}
    assert refused(api.patch(where, json=said, headers=headers)) == (428, "precondition_required")
    assert refused(api.patch(where, json=said, headers={**headers, "If-Match": '"1"'})) == (412, "precondition_failed")
    tag = api.get(where, headers=headers).headers["ETag"]
    changed = answered(api.patch(where, json=said, headers={**headers, "If-Match": tag}), 200)
    assert (changed["method"], changed["description"], changed["modality"]) == ("Net v2", "More\ndata.", "L")
    again = api.patch(where, json={"modality": "C"}, headers={**headers, "If-Match": f'"{changed["revision"]}"'})
    assert refused(again) == (409, "wrong_state")


def test_acts_out_of_order_are_refused_and_change_nothing(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    submission = team.submitted()
    assert refused(team.post(f"{submission['id']}/withdraw")) == (409, "wrong_state")
    assert refused(team.finalize(submission["id"], NOBODY)) == (409, "wrong_state")
    cancelled = answered(team.post(f"{submission['id']}/cancel"), 200)
    assert (cancelled["state"], team.quota()["reserved"]) == ("cancelled", 0)
    assert refused(team.post(f"{submission['id']}/cancel")) == (409, "wrong_state")
    assert answered(team.post(f"{submission['id']}/withdraw"), 200)["withdrawn_at"] is not None
    draft = team.announced()
    assert refused(team.finalize(draft["id"], NOBODY)) == (404, "upload_missing")


def test_administrators_hide_and_say_why(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    submission_id = team.submitted()["id"]
    where = f"{URL}/admin/submissions/{submission_id}/visibility"
    body = {"hidden": True, "reason": "trained on the test part"}
    assert refused(api.put(where, json=body, headers=team.caller.headers)) == (403, "forbidden")
    administrator = person(platform, "administrator")
    hidden = answered(api.put(where, json=body, headers=administrator.headers), 200)
    assert hidden["hidden_at"] is not None
    assert team.shown(submission_id)["hidden_reason"] == "trained on the test part"
    shown = answered(api.put(where, json={**body, "hidden": False}, headers=administrator.headers), 200)
    assert (shown["hidden_at"], shown["hidden_reason"]) == (None, "")
    with platform.database.reading() as session:
        acts = session.scalars(select(AuditEntry.act).order_by(AuditEntry.number.desc()).limit(2)).all()
    assert acts == ["submission.unhide", "submission.hide"]


def test_a_submission_is_followed_until_it_ends(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    submission_id = team.submitted()["id"]
    path = f"{URL}/submissions/{submission_id}/events"
    (name, version, data) = listen(api, path, team.caller, most=1)[0]
    assert (name, data) == ("progress", team.shown(submission_id))
    with platform.database.transaction() as session:
        settle(session, submission_id, "invalid", problems={"ok": False, "errors": [], "errors_total": 3})
    heard = listen(api, path, team.caller, last=version)
    assert [(name, data["state"], data["problems_total"]) for name, _, data in heard] == [("ended", "invalid", 3)]
    seen = {**team.caller.headers, "Last-Event-ID": heard[0][1]}
    assert api.get(path, headers=seen).status_code == 204
