"""An upload for a submission is what its draft announces, of somebody of its team, within a quota of its own."""

from dataclasses import replace
from hashlib import sha256
from typing import Any

import pytest

from services.domain.benchmarks.submissions.submissions import cancel
from services.runtime.access.storage_quota import QuotaExceededError
from services.runtime.orm import SubmissionRow, TeamMember, Upload
from services.runtime.platform import Platform
from services.runtime.settings import SubmissionSettings
from services.runtime.store import blobs
from services.runtime.uploads import upload_file
from services.runtime.uploads.creation import create
from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.errors import UndeclaredUploadError, UploadTargetMissingError
from services.runtime.uploads.rows import UploadOwner
from testing.api.serving import Person
from tests.services.domain.benchmarks.drafts import (
    ZIP,
    Entrant,
    another_entrant,
    drafted,
    entrant_on,
    finalised,
    seen,
    uploaded,
)

SHA256 = sha256(ZIP).hexdigest()


def begun(entrant: Entrant, submission_id: str, by: Person | None = None, **said: Any) -> Upload:
    """An upload for the draft, by its captain unless somebody else is named; `said` differs from what is announced."""
    usual = {"length_bytes": len(ZIP), "sha256": SHA256, "target_id": submission_id, **said}
    declared = UploadDeclaration("run.zip", "submission", **usual)
    return create(entrant.platform, UploadOwner((by or entrant.captain).user_id, is_participant=True), declared)


def test_the_announced_file_of_ones_own_team_is_taken(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on)
    upload = begun(entrant, drafted(entrant))
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
    entrant = entrant_on(platform)
    with pytest.raises(UndeclaredUploadError, match=match):
        begun(entrant, drafted(entrant), **said)


def test_drafts_of_others_do_not_exist_even_for_administrators(platform: Platform) -> None:
    entrant = entrant_on(platform)
    theirs = drafted(another_entrant(entrant.place))
    for target_id in (theirs, "0" * 32, ""):
        with pytest.raises(UploadTargetMissingError):
            begun(entrant, target_id)
    declared = UploadDeclaration("run.zip", "submission", len(ZIP), theirs, SHA256)
    with pytest.raises(UploadTargetMissingError):
        create(platform, UploadOwner(entrant.captain.user_id, is_administrator=True), declared)


def test_a_member_may_send_what_the_captain_announced(platform: Platform) -> None:
    entrant = entrant_on(platform)
    member = another_entrant(entrant.place).captain
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=member.user_id))
    submission_id = drafted(entrant)
    upload = begun(entrant, submission_id, by=member)
    assert upload.owner_id == member.user_id
    with platform.database.transaction() as session:
        row = session.get_one(Upload, upload.id)
        row.state, row.sha256 = "complete", SHA256
    finalised(entrant, submission_id, upload.id)


@pytest.mark.parametrize("end", ["finalised", "cancelled"])
def test_what_is_no_draft_any_more_takes_no_file(platform: Platform, end: str) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    if end == "finalised":
        finalised(entrant, submission_id)
    else:
        with platform.database.transaction() as session:
            cancel(session, session.get_one(SubmissionRow, submission_id))
    with pytest.raises(UploadTargetMissingError):
        begun(entrant, submission_id)


def test_participants_have_a_quota_of_their_own(platform_on: Platform) -> None:
    few = SubmissionSettings(participant_bytes=2 * len(ZIP) - 1)
    narrow = replace(platform_on, settings=platform_on.settings.model_copy(update={"submissions": few}))
    entrant = entrant_on(narrow)
    begun(entrant, drafted(entrant))
    with pytest.raises(QuotaExceededError, match=f"{len(ZIP)} of {2 * len(ZIP) - 1} bytes are used"):
        begun(entrant, drafted(entrant))
    declared = UploadDeclaration("run.zip", "submission", len(ZIP), drafted(entrant), SHA256)
    create(narrow, UploadOwner(entrant.captain.user_id), declared)


@pytest.mark.parametrize("where", ["uploads", "store"])
def test_a_file_that_was_validated_is_not_sent_again_to_be_scored(platform: Platform, where: str) -> None:
    entrant = entrant_on(platform)
    validated = drafted(entrant, kind="validation")
    first = uploaded(entrant, validated)
    finalised(entrant, validated, first)
    path = upload_file(platform.settings, first)
    if where == "store":
        with platform.database.transaction() as session:
            blob = blobs.keep(session, platform.store, path, adopt=True)
            session.get_one(SubmissionRow, validated).blob_sha256 = blob.sha256
        path.unlink()
    entry = drafted(entrant)
    upload = begun(entrant, entry)
    assert upload.state == "complete"
    assert upload_file(platform.settings, upload.id).read_bytes() == ZIP
    finalised(entrant, entry, upload.id)
    assert seen(entrant, entry).state == "queued"


def test_what_others_have_sent_is_never_taken_for_ones_own(platform: Platform) -> None:
    entrant = entrant_on(platform)
    other = another_entrant(entrant.place)
    finalised(other)
    assert begun(entrant, drafted(entrant)).state == "open"
