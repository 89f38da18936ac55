"""How many uploads wait is bounded, by owner and by draft, also where two would take the last place at once."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier
from typing import Any

import pytest
from sqlalchemy import func, select

from services.domain.benchmarks.submissions.submissions import MOST_OPEN
from services.runtime.orm import SubmissionRow, TeamMember, Upload
from services.runtime.platform import Platform
from services.runtime.settings import SubmissionSettings, UploadSettings
from services.runtime.uploads import consume
from services.runtime.uploads.completion import terminate
from services.runtime.uploads.errors import (
    TooManyUploadsError,
    TooManyUploadsOfDraftError,
    UploadTargetMissingError,
)
from services.runtime.uploads.rows import is_waiting
from stone_files.bag_files import MOST_FILES
from tests.services.domain.benchmarks.drafts import Entrant, another_entrant, drafted, entrant_on
from tests.services.runtime.uploads.living import complete, used
from tests.services.runtime.uploads.sending import BAG, made, make_owner
from tests.services.runtime.uploads.test_submitted import begun

THREADS = 6
Refused = type[TooManyUploadsError] | type[TooManyUploadsOfDraftError]


def bounded(platform: Platform, **limits: int) -> Platform:
    """The platform with other limits of these names."""
    settings: dict[str, Any] = {}
    for group in ("uploads", "submissions"):
        values = getattr(platform.settings, group)
        settings[group] = replace(values, **{name: limit for name, limit in limits.items() if hasattr(values, name)})
    return replace(platform, settings=platform.settings.model_copy(update=settings))


def waiting(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Upload).where(is_waiting())) or 0


def outcomes(act: Callable[[int], object], refused: Refused) -> list[bool]:
    """Who succeeded of some who do it at the same moment."""
    together = Barrier(THREADS)

    def try_it(number: int) -> bool:
        together.wait(timeout=300)
        try:
            act(number)
        except refused:
            return False
        return True

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(try_it, range(THREADS)))


def test_an_owner_has_so_many_waiting_uploads_and_one_more_leaves_no_trace(placed_on: Platform) -> None:
    small, owner = bounded(placed_on, owner_waiting=2), make_owner(placed_on)
    made(small, owner, b"1")
    complete(small, owner)
    before = used(small, owner)
    with pytest.raises(TooManyUploadsError, match=r"^2 uploads of yours are unfinished or not used yet"):
        made(small, owner, b"2")
    assert (waiting(small), used(small, owner)) == (2, before)
    folder = small.settings.uploads_folder
    assert len(list(folder.iterdir()) if folder.is_dir() else []) <= 2
    made(small, make_owner(small, "bob"), b"3")


def test_whoever_uses_or_ends_an_upload_has_its_place_again(placed_on: Platform) -> None:
    small, owner = bounded(placed_on, owner_waiting=1), make_owner(placed_on)
    with small.database.transaction() as session:
        consume(session, complete(small, owner).id, owner.user_id, "recording")
    terminate(small, made(small, owner, b"1"))
    made(small, owner, b"2")
    with pytest.raises(TooManyUploadsError):
        made(small, owner, b"3")


def test_a_file_that_is_here_already_takes_a_place_as_any_other(placed: Platform) -> None:
    small, owner = bounded(placed, owner_waiting=2), make_owner(placed)
    sha256 = complete(small, owner).sha256
    assert made(small, owner, BAG, sha256=sha256).state == "complete"
    with pytest.raises(TooManyUploadsError):
        made(small, owner, BAG, sha256=sha256)


def test_of_several_creations_at_once_one_takes_the_owners_last_place(placed_on: Platform) -> None:
    small, owner = bounded(placed_on, owner_waiting=2), make_owner(placed_on)
    made(small, owner, b"0")
    assert sum(outcomes(lambda number: made(small, owner, b"x" * number), TooManyUploadsError)) == 1
    assert waiting(small) == 2


def test_a_participant_has_a_bound_of_their_own(platform_on: Platform) -> None:
    entrant = entrant_on(bounded(platform_on, participant_waiting=1))
    begun(entrant, drafted(entrant))
    with pytest.raises(TooManyUploadsError, match=r"^1 uploads of yours"):
        begun(entrant, drafted(entrant))


def test_a_draft_has_so_many_waiting_uploads_whoever_of_its_team_made_them(platform_on: Platform) -> None:
    entrant = entrant_on(bounded(platform_on, draft_waiting=2))
    member = another_entrant(entrant.place).captain
    with platform_on.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=member.user_id))
    draft_id = drafted(entrant)
    begun(entrant, draft_id)
    begun(entrant, draft_id, by=member)
    for who in (entrant.captain, member):
        with pytest.raises(TooManyUploadsOfDraftError, match=f"^2 uploads for the draft '{draft_id}'.*resume that one"):
            begun(entrant, draft_id, by=who)
    begun(entrant, drafted(entrant))


def test_of_a_team_that_uploads_at_once_one_takes_the_drafts_last_place(platform_on: Platform) -> None:
    """No owner's lock keeps them apart: each is another."""
    entrant = entrant_on(bounded(platform_on, draft_waiting=2))
    people = [entrant.captain, *members_of(entrant, THREADS - 1)]
    draft_id = drafted(entrant)
    begun(entrant, draft_id)
    done = outcomes(lambda number: begun(entrant, draft_id, by=people[number]), TooManyUploadsOfDraftError)
    assert sum(done) == 1
    assert waiting(platform_on) == 2


def test_a_draft_that_went_while_its_upload_was_made_takes_none(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was there when it was looked at, and somebody removed it before the upload's row was made."""
    entrant = entrant_on(platform_on)
    draft_id = drafted(entrant)

    def look_and_lose(*_: object) -> None:
        with platform_on.database.transaction() as session:
            session.delete(session.get_one(SubmissionRow, draft_id))

    monkeypatch.setattr("services.runtime.uploads.creation.refuse_foreign_target", look_and_lose)
    with pytest.raises(UploadTargetMissingError):
        begun(entrant, draft_id)
    assert waiting(platform_on) == 0


def test_no_bag_and_no_phase_comes_near_a_bound() -> None:
    """A bag of as many files as there may be waits whole, a team's drafts of a phase wait all at once."""
    assert UploadSettings().owner_waiting >= 4 * MOST_FILES
    assert SubmissionSettings().participant_waiting >= 4 * MOST_OPEN
    assert SubmissionSettings().draft_waiting > 1


def members_of(entrant: Entrant, count: int) -> list[Any]:
    """People who join the team."""
    people = [another_entrant(entrant.place).captain for _ in range(count)]
    with entrant.platform.database.transaction() as session:
        session.add_all(TeamMember(team_id=entrant.team_id, user_id=one.user_id) for one in people)
    return people
