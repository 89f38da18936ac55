"""Submissions over HTTP: whose they are, what is refused and how, and the whole way from a zip to its verdict."""

from datetime import UTC, datetime, timedelta

import httpx
from sqlalchemy import select

from services.domain.benchmarks.submissions.submissions import settle, settle_ended
from services.runtime.access import tokens
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import AuditEntry, User
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.api.tus import TUS, ask, create, patch
from testing.worlds.made import NOBODY
from tests.api.submitting import URL, answered, refused, submitting
from tests.api.test_events import listen
from tests.services.domain.benchmarks.drafts import ZIP


def test_what_is_announced_is_shown_and_found_again(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
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
    with platform.database.reading() as session:
        acts = session.scalars(select(AuditEntry.act).where(AuditEntry.subject_id == draft["id"]))
        assert list(acts.all()) == ["submission.announce", "submission.finalize"]


def test_a_quota_that_is_used_up_says_when_the_next_is_free(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform, scorings_per_window=1)
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


def test_lists_are_filtered(api: httpx.Client, platform: Platform) -> None:
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


def test_an_upload_for_a_submission_needs_the_scope_submit_and_the_draft(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    draft = team.announced()
    said = {"purpose": "submission", "target_id": draft["id"], "sha256": draft["sha256"]}
    assert refused(create(api, team.caller, len(ZIP) + 1, **said)) == (409, "not_as_announced")
    unsaid = {"purpose": "submission", "target_id": draft["id"]}
    assert refused(create(api, team.caller, len(ZIP), **unsaid)) == (409, "not_as_announced")
    assert refused(create(api, team.caller, len(ZIP), purpose="recording")) == (403, "forbidden")
    stranger = person(platform, "participant")
    assert refused(create(api, stranger, len(ZIP), **said)) == (404, "upload_target_missing")
    sender = person(platform, "curator", scopes=["read", "upload"])
    assert refused(create(api, sender, len(ZIP), **said)) == (403, "forbidden")
    where = str(create(api, team.caller, len(ZIP), **said).headers["Location"])
    assert patch(api, team.caller, where, 0, ZIP[:5]).headers["Upload-Offset"] == "5"
    assert ask(api, team.caller, where).headers["Upload-Offset"] == "5"
    assert api.delete(where, headers={**TUS, **team.caller.headers}).status_code == 204


def test_who_may_only_submit_does_not_touch_a_recording_of_their_own(api: httpx.Client, platform: Platform) -> None:
    curator = person(platform, "curator")
    where = str(create(api, curator, 5).headers["Location"])
    with platform.database.transaction() as session:
        secret = tokens.issue(session, session.get_one(User, curator.user_id), "narrow", ["submit"], 100.0)
    narrow = Person(curator.user_id, curator.name, secret)
    assert ask(api, narrow, where).status_code == 403
    assert refused(patch(api, narrow, where, 0, b"hello")) == (403, "forbidden")
    assert refused(api.delete(where, headers={**TUS, **narrow.headers})) == (403, "forbidden")


def test_what_raised_while_scoring_is_for_administrators_to_read(api: httpx.Client, platform: Platform) -> None:
    team = submitting(api, platform)
    submission = team.submitted()

    def stage(attempt: Attempt) -> Outcome:
        attempt.log("counting", frames=3)
        raise KeyError("a voxel of the truth")

    while run_next(platform, "eval", {"eval.open": stage}):
        pass
    settle_ended(platform)
    where = f"{URL}/jobs/{submission['job_id']}"
    root = team.read(f"jobs?root_id={submission['job_id']}").json()["items"][0]["id"]
    told = [team.read(f"submissions/{submission['id']}"), team.read(f"jobs/{root}"), team.read(f"jobs/{root}/logs")]
    told += [api.get(f"{where}{path}", headers=team.caller.headers) for path in ("", "/logs", "/events")]
    assert all(reply.status_code == 200 and "voxel" not in reply.text for reply in told)
    assert all("KeyError" in reply.text for reply in told[1:2])
    assert "counting" in told[2].text
    administrator = person(platform, "administrator")
    logs = api.get(f"{URL}/admin/jobs/{submission['job_id']}/logs", headers=administrator.headers)
    assert "KeyError: 'a voxel of the truth'" in logs.text
