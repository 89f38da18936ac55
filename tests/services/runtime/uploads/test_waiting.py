"""How many uploads wait is bounded, by owner and by draft, also if two would take the last place at once.

An upload for a submission is what its draft announces, of somebody of its team, within a quota of its own.
"""

from hashlib import sha256
from typing import Any

import pytest
from sqlalchemy import func, select

from services.domain.benchmarks.submissions.submissions import cancel
from services.runtime.orm import SubmissionRow, TeamMember, Upload
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.uploads import consume, upload_file
from services.runtime.uploads.completion import terminate
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.rows import UploadOwner, is_waiting
from testing.api.serving import Person
from testing.refusals import refused_as
from testing.servers.fixtures import having
from testing.threads import granted
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
from tests.services.runtime.uploads.living import complete, used
from tests.services.runtime.uploads.sending import BAG, made, make_owner

THREADS = 6


def waiting(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Upload).where(is_waiting())) or 0


def test_an_owner_has_so_many_waiting_uploads_and_one_more_leaves_no_trace(placed: Platform) -> None:
    small, owner = having(placed, uploads={"owner_waiting": 2}), make_owner(placed)
    made(small, owner, b"1")
    complete(small, owner)
    before = used(small, owner)
    with refused_as("too_many_uploads", match=r"^you have 2 unfinished"):
        made(small, owner, b"2")
    assert (waiting(small), used(small, owner)) == (2, before)
    folder = small.settings.uploads_folder
    assert len(list(folder.iterdir()) if folder.is_dir() else []) <= 2
    made(small, make_owner(small, "bob"), b"3")


def test_whoever_uses_or_ends_an_upload_has_its_place_again(placed: Platform) -> None:
    small, owner = having(placed, uploads={"owner_waiting": 1}), make_owner(placed)
    with small.database.transaction() as session:
        consume(session, complete(small, owner).id, owner.user_id, "recording")
    terminate(small, made(small, owner, b"1"))
    made(small, owner, b"2")
    with refused_as("too_many_uploads"):
        made(small, owner, b"3")


def test_a_file_that_is_here_already_takes_a_place_as_any_other(placed: Platform) -> None:
    small, owner = having(placed, uploads={"owner_waiting": 2}), make_owner(placed)
    sha256 = complete(small, owner).sha256
    assert made(small, owner, BAG, sha256=sha256).state == "complete"
    with refused_as("too_many_uploads"):
        made(small, owner, BAG, sha256=sha256)


def test_of_several_creations_at_once_one_takes_the_owners_last_place(placed_on: Platform) -> None:
    small, owner = having(placed_on, uploads={"owner_waiting": 2}), make_owner(placed_on)
    made(small, owner, b"0")
    assert granted(THREADS, lambda number: made(small, owner, b"x" * number), "too_many_uploads") == 1
    assert waiting(small) == 2


def test_a_participant_has_a_bound_of_their_own(platform: Platform) -> None:
    entrant = entrant_on(having(platform, submissions={"participant_waiting": 1}))
    begun(entrant, drafted(entrant))
    with refused_as("too_many_uploads", match=r"^you have 1 unfinished"):
        begun(entrant, drafted(entrant))


def test_a_draft_has_so_many_waiting_uploads_whoever_of_its_team_made_them(platform: Platform) -> None:
    entrant = entrant_on(having(platform, submissions={"draft_waiting": 2}))
    member = another_entrant(entrant.place).captain
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=member.user_id))
    draft_id = drafted(entrant)
    begun(entrant, draft_id)
    begun(entrant, draft_id, by=member)
    for who in (entrant.captain, member):
        with refused_as("too_many_uploads_of_draft", match=r"has 2 unfinished"):
            begun(entrant, draft_id, by=who)
    begun(entrant, drafted(entrant))


def test_of_a_team_that_uploads_at_once_one_takes_the_drafts_last_place(platform_on: Platform) -> None:
    """No owner's lock keeps them apart: each is another."""
    entrant = entrant_on(having(platform_on, submissions={"draft_waiting": 2}))
    people = [entrant.captain, *members_of(entrant, THREADS - 1)]
    draft_id = drafted(entrant)
    begun(entrant, draft_id)
    done = granted(THREADS, lambda number: begun(entrant, draft_id, by=people[number]), "too_many_uploads_of_draft")
    assert done == 1
    assert waiting(platform_on) == 2


def test_a_draft_that_went_while_its_upload_was_made_takes_none(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was there when it was looked at, and somebody removed it before the upload's row was made."""
    entrant = entrant_on(platform)
    draft_id = drafted(entrant)

    def look_and_lose(*_: object) -> None:
        with platform.database.transaction() as session:
            session.delete(session.get_one(SubmissionRow, draft_id))

    monkeypatch.setattr("services.runtime.uploads.creation.refuse_foreign_target", look_and_lose)
    with refused_as("upload_target_missing"):
        begun(entrant, draft_id)
    assert waiting(platform) == 0


def members_of(entrant: Entrant, count: int) -> list[Any]:
    """People who join the team."""
    people = [another_entrant(entrant.place).captain for _ in range(count)]
    with entrant.platform.database.transaction() as session:
        session.add_all(TeamMember(team_id=entrant.team_id, user_id=one.user_id) for one in people)
    return people


SHA256 = sha256(ZIP).hexdigest()


def begun(entrant: Entrant, submission_id: str, by: Person | None = None, **said: Any) -> Upload:
    """An upload for the draft, by its captain unless somebody else is named; `said` differs from what is announced."""
    usual = {"length_bytes": len(ZIP), "sha256": SHA256, "target_id": submission_id, **said}
    declared = UploadDeclaration("run.zip", "submission", **usual)
    return create(entrant.platform, UploadOwner((by or entrant.captain).user_id, is_participant=True), declared)


@pytest.mark.parametrize("said", [{"length_bytes": len(ZIP) + 1}, {"sha256": "1" * 64}, {"sha256": ""}])
def test_any_other_file_is_refused_before_a_byte_is_sent(platform: Platform, said: dict[str, Any]) -> None:
    entrant = entrant_on(platform)
    with refused_as("not_as_announced"):
        begun(entrant, drafted(entrant), **said)


def test_drafts_of_others_do_not_exist_even_for_administrators(platform: Platform) -> None:
    entrant = entrant_on(platform)
    theirs = drafted(another_entrant(entrant.place))
    for target_id in (theirs, "0" * 32, ""):
        with refused_as("upload_target_missing"):
            begun(entrant, target_id)
    declared = UploadDeclaration("run.zip", "submission", len(ZIP), theirs, SHA256)
    with refused_as("upload_target_missing"):
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
    with refused_as("upload_target_missing"):
        begun(entrant, submission_id)


def test_participants_have_a_quota_of_their_own(platform: Platform) -> None:
    narrow = having(platform, submissions={"participant_bytes": 2 * len(ZIP) - 1})
    entrant = entrant_on(narrow)
    begun(entrant, drafted(entrant))
    with refused_as("quota_exceeded", match=f"{len(ZIP)} of {2 * len(ZIP) - 1} "):
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
