"""An upload for a submission is what its draft announces, of somebody of its team, within a quota of its own."""

from dataclasses import replace
from hashlib import sha256
from typing import Any

import pytest

from services.runtime import blobs
from services.runtime.benchmarks.submissions import cancel
from services.runtime.orm import Submission, TeamMember, Upload
from services.runtime.platform import Platform
from services.runtime.quota import QuotaExceededError
from services.runtime.settings import SubmissionSettings
from services.runtime.uploads import upload_file
from services.runtime.uploads.creating import create
from services.runtime.uploads.declared import Declared
from services.runtime.uploads.errors import UndeclaredUploadError, UploadTargetMissingError
from services.runtime.uploads.rows import Owner
from tests.api.serving import Person
from tests.services.runtime.benchmarks.drafts import (
    ZIP,
    Desk,
    another_desk,
    desk_on,
    drafted,
    finalised,
    seen,
    uploaded,
)

SHA256 = sha256(ZIP).hexdigest()


def begun(desk: Desk, submission_id: str, by: Person | None = None, **said: Any) -> Upload:
    """An upload for the draft, by its captain unless somebody else is named; `said` differs from what is announced."""
    usual = {"length_bytes": len(ZIP), "sha256": SHA256, "target_id": submission_id, **said}
    declared = Declared("run.zip", "submission", **usual)
    return create(desk.platform, Owner((by or desk.captain).user_id, is_participant=True), declared)


def test_the_announced_file_of_ones_own_team_is_taken(platform_on: Platform) -> None:
    desk = desk_on(platform_on)
    upload = begun(desk, drafted(desk))
    assert (upload.state, upload.length_bytes, upload.declared_sha256) == ("open", len(ZIP), SHA256)


@pytest.mark.parametrize(
    ("said", "match"),
    [
        ({"length_bytes": len(ZIP) + 1}, "length is '21', the draft announces '20'"),
        ({"sha256": "1" * 64}, "sha256 is '111"),
        ({"sha256": ""}, "sha256 is ''"),
    ],
)
def test_any_other_file_is_refused_before_a_byte_is_sent(platform: Platform, said: dict[str, Any], match: str) -> None:
    desk = desk_on(platform)
    with pytest.raises(UndeclaredUploadError, match=match):
        begun(desk, drafted(desk), **said)


def test_drafts_of_others_do_not_exist_even_for_administrators(platform: Platform) -> None:
    desk = desk_on(platform)
    theirs = drafted(another_desk(desk.place))
    for target_id in (theirs, "0" * 32, ""):
        with pytest.raises(UploadTargetMissingError):
            begun(desk, target_id)
    declared = Declared("run.zip", "submission", len(ZIP), theirs, SHA256)
    with pytest.raises(UploadTargetMissingError):
        create(platform, Owner(desk.captain.user_id, is_administrator=True), declared)


def test_a_member_may_send_what_the_captain_announced(platform: Platform) -> None:
    desk = desk_on(platform)
    member = another_desk(desk.place).captain
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=desk.team_id, user_id=member.user_id))
    submission_id = drafted(desk)
    upload = begun(desk, submission_id, by=member)
    assert upload.owner_id == member.user_id
    with platform.database.transaction() as session:
        row = session.get_one(Upload, upload.id)
        row.state, row.sha256 = "complete", SHA256
    finalised(desk, submission_id, upload.id)


@pytest.mark.parametrize("end", ["finalised", "cancelled"])
def test_what_is_no_draft_any_more_takes_no_file(platform: Platform, end: str) -> None:
    desk = desk_on(platform)
    submission_id = drafted(desk)
    if end == "finalised":
        finalised(desk, submission_id)
    else:
        with platform.database.transaction() as session:
            cancel(session, session.get_one(Submission, submission_id))
    with pytest.raises(UploadTargetMissingError):
        begun(desk, submission_id)


def test_participants_have_a_quota_of_their_own(platform_on: Platform) -> None:
    few = SubmissionSettings(participant_bytes=2 * len(ZIP) - 1)
    narrow = replace(platform_on, settings=platform_on.settings.model_copy(update={"submissions": few}))
    desk = desk_on(narrow)
    begun(desk, drafted(desk))
    with pytest.raises(QuotaExceededError, match=f"{len(ZIP)} of {2 * len(ZIP) - 1} bytes are used"):
        begun(desk, drafted(desk))
    declared = Declared("run.zip", "submission", len(ZIP), drafted(desk), SHA256)
    create(narrow, Owner(desk.captain.user_id), declared)


@pytest.mark.parametrize("where", ["uploads", "store"])
def test_a_file_that_was_validated_is_not_sent_again_to_be_scored(platform: Platform, where: str) -> None:
    desk = desk_on(platform)
    validated = drafted(desk, kind="validation")
    first = uploaded(desk, validated)
    finalised(desk, validated, first)
    path = upload_file(platform.settings, first)
    if where == "store":
        with platform.database.transaction() as session:
            blob = blobs.keep(session, platform.store, path, adopt=True)
            session.get_one(Submission, validated).blob_sha256 = blob.sha256
        path.unlink()
    entry = drafted(desk)
    upload = begun(desk, entry)
    assert upload.state == "complete"
    assert upload_file(platform.settings, upload.id).read_bytes() == ZIP
    finalised(desk, entry, upload.id)
    assert seen(desk, entry).state == "queued"


def test_what_others_have_sent_is_never_taken_for_ones_own(platform: Platform) -> None:
    desk = desk_on(platform)
    other = another_desk(desk.place)
    finalised(other)
    assert begun(desk, drafted(desk)).state == "open"
