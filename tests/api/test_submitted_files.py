"""The file of a submission: who may send it, how it goes from a zip to its verdict, and what is told of the way."""

from pathlib import Path

import httpx
from sqlalchemy import func, select

from services.domain.benchmarks.submissions.submissions import settle_ended
from services.runtime.access import tokens
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import SubmissionRow, User
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.api.tus import TUS, ask, create, patch
from testing.worlds.benchmark_world import benchmark_world, predicted, run_eval, submission_zip
from tests.api.submitting import URL, Submitting, answered, refused, submitting
from tests.services.domain.benchmarks.drafts import ZIP


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


def test_a_zip_goes_all_the_way_to_its_verdict(platform: Platform, tmp_path: Path) -> None:
    world = benchmark_world(platform, frames=1)
    frames = predicted(world.truth("test"), 0.1)
    content = submission_zip(tmp_path / "all.zip", frames).read_bytes()
    short = submission_zip(tmp_path / "short.zip", dict(list(frames.items())[1:])).read_bytes()
    with client_of(platform) as api:
        team = Submitting(api, world.captains[0], world.test, world.teams[0])
        checked = team.submitted(short, "validations")
        entry, refused_entry = team.submitted(content), team.submitted(short)
        run_eval(platform)
        states = [team.shown(one["id"])["state"] for one in (checked, entry, refused_entry)]
        assert states == ["invalid", "scored", "invalid"]
        report = answered(team.read(f"submissions/{refused_entry['id']}/validation-report"), 200)
        assert (report["ok"], report["errors_total"], report["errors"][0]["code"]) == (False, 1, "missing_frame")
        assert answered(team.read(f"submissions/{entry['id']}/validation-report"), 200)["ok"] is True
        assert (team.quota()["used"], team.quota()["reserved"]) == (1, 0)
        answered(team.post(f"{entry['id']}/withdraw", {"reason": "a bug"}), 200)
        assert team.quota()["used"] == 1
    with platform.database.reading() as session:
        assert (
            session.scalar(select(func.count()).select_from(SubmissionRow).where(SubmissionRow.state == "scored")) == 1
        )
