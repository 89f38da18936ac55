"""Parts that came side by side are one upload, whichever backend they lie in and wherever the joining was cut off."""

from collections.abc import Sequence
from itertools import pairwise

import pytest
from sqlalchemy import func, select

from services.runtime.orm import QuotaEntry, Upload
from services.runtime.platform import Platform
from services.runtime.uploads import expire, joining
from services.runtime.uploads.backends import FolderUploadBackend, backend_of, backends
from services.runtime.uploads.completion import settle_if_whole, terminate
from services.runtime.uploads.creation import UploadDeclaration, create
from services.runtime.uploads.errors import FileMismatchError
from services.runtime.uploads.files import LockedUploadFile
from services.runtime.uploads.joining import MOST_PARTS, create_joined
from services.runtime.uploads.reception import UploadChunk, receive
from services.runtime.uploads.rows import PART, UploadOwner, find
from testing.refusals import refused_as
from tests.services.runtime.uploads.conftest import with_place
from tests.services.runtime.uploads.sending import BAG, declared, make_owner, send, sha256_of

CUTS = (0, 10, 700, 701, len(BAG))


@pytest.fixture(params=["folder", "store"])
def placed(request: pytest.FixtureRequest, platform: Platform) -> Platform:
    return with_place(platform, request.param, part_bytes=2**16)


def parts_of(platform: Platform, owner: UploadOwner, content: bytes = BAG, cuts: Sequence[int] = CUTS) -> list[str]:
    """The ids of complete parts, sent in another order than theirs."""
    ids = {}
    for start, stop in sorted(pairwise(cuts), reverse=True):
        part = create(platform, owner, UploadDeclaration("part", PART, stop - start))
        send(platform, part, 0, content[start:stop])
        ids[start] = part.id
    return [ids[start] for start in sorted(ids)]


def content_of(platform: Platform, upload: Upload) -> bytes:
    with backend_of(platform, upload).local(upload) as path:
        return path.read_bytes()


def taken_bytes(platform: Platform) -> int:
    with platform.database.reading() as session:
        return session.scalar(select(func.sum(QuotaEntry.amount))) or 0


def joined(platform: Platform, owner: UploadOwner, ids: Sequence[str], sha256: str = "") -> Upload:
    whole = create_joined(platform, owner, declared(b"", sha256=sha256), ids)
    return settle_if_whole(platform, whole)


def test_parts_are_one_upload_in_the_order_in_which_they_are_named(placed: Platform) -> None:
    owner = make_owner(placed)
    whole = joined(placed, owner, parts_of(placed, owner), sha256_of(BAG))
    assert (whole.state, whole.length_bytes, whole.sha256, whole.detail) == ("complete", len(BAG), sha256_of(BAG), "")
    assert content_of(placed, whole) == BAG
    assert taken_bytes(placed) == len(BAG)
    assert list(backend_of(placed, whole).holding()) == [whole.id]


def test_a_joining_that_was_killed_goes_on_and_never_needs_much_more_than_the_file(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joining, "COPIED_BYTES", 100)
    owner = make_owner(platform)
    whole = create_joined(platform, owner, declared(b"", sha256=sha256_of(BAG)), parts_of(platform, owner))
    folder, most_bytes, kills = platform.settings.uploads_folder, 0, 0
    append = LockedUploadFile.append

    def killed_after_it(held: LockedUploadFile, pieces: Sequence[bytes], offset_bytes: int) -> None:
        nonlocal most_bytes
        append(held, pieces, offset_bytes)
        most_bytes = max(most_bytes, sum(path.stat().st_size for path in folder.iterdir()))
        raise RuntimeError("killed")

    monkeypatch.setattr(LockedUploadFile, "append", killed_after_it)
    while (current := find(platform.database, whole.id, owner.user_id)).state == "open":
        try:
            settle_if_whole(platform, current)
        except RuntimeError:
            kills += 1
    assert kills >= len(BAG) // 100
    assert (current.sha256, content_of(platform, current)) == (sha256_of(BAG), BAG)
    assert most_bytes <= len(BAG) + max(stop - start for start, stop in pairwise(CUTS))
    assert list(FolderUploadBackend(platform).holding()) == [whole.id]


def test_the_sweeper_ends_what_a_server_that_died_began(placed: Platform) -> None:
    owner = make_owner(placed)
    whole = create_joined(placed, owner, declared(b""), parts_of(placed, owner))
    assert find(placed.database, whole.id, owner.user_id).state == "open"
    expire(placed)
    assert content_of(placed, find(placed.database, whole.id, owner.user_id)) == BAG


def test_parts_of_another_file_fail_the_whole_and_their_bytes_go(placed: Platform) -> None:
    owner = make_owner(placed)
    with pytest.raises(FileMismatchError):
        joined(placed, owner, parts_of(placed, owner), "ab" * 32)
    expire(placed)
    assert taken_bytes(placed) == 0
    assert not any(list(backend.holding()) for backend in backends(placed))


def test_a_whole_that_is_given_up_takes_its_parts_with_it(placed: Platform) -> None:
    owner = make_owner(placed)
    whole = create_joined(placed, owner, declared(b""), parts_of(placed, owner))
    terminate(placed, whole)
    expire(placed)
    assert taken_bytes(placed) == 0
    assert list(backend_of(placed, whole).holding()) == []


def test_what_cannot_be_joined_is_refused_and_nothing_is_taken(placed: Platform) -> None:
    ada, eve = make_owner(placed), make_owner(placed, "eve")
    ids = parts_of(placed, ada)
    unfinished = create(placed, ada, UploadDeclaration("part", PART, 5)).id
    other = create(placed, ada, declared(BAG)).id
    before = taken_bytes(placed)
    for owner, named, code in (
        (ada, [], "bad_parts"),
        (ada, [ids[0], ids[0]], "bad_parts"),
        (ada, [f"{number:032x}" for number in range(MOST_PARTS + 1)], "bad_parts"),
        (ada, [*ids, other], "bad_parts"),
        (ada, [*ids, unfinished], "wrong_upload_state"),
        (eve, ids, "upload_missing"),
    ):
        with refused_as(code):
            create_joined(placed, owner, declared(b""), named)
    assert taken_bytes(placed) == before
    create_joined(placed, ada, declared(b""), ids)
    with refused_as("wrong_upload_state"):
        create_joined(placed, ada, declared(b""), ids)


def test_a_whole_takes_no_bytes_of_its_own(placed: Platform) -> None:
    owner = make_owner(placed)
    whole = create_joined(placed, owner, declared(b""), parts_of(placed, owner))
    with refused_as("joined_upload"):
        receive(placed, whole.id, owner.user_id, UploadChunk(0, 5))
