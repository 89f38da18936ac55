"""A file that its owner has here already is not sent again; what others have stays unknown."""

from stat import S_ISREG

from services.runtime.platform import Platform
from services.runtime.uploads import expire
from services.runtime.uploads.completion import terminate
from tests.services.runtime.uploads.living import complete, record, used
from tests.services.runtime.uploads.sending import BAG, kept, made, make_owner, sha256_of


def bytes_in_use(platform: Platform) -> int:
    """On the disk, what has several names once."""
    root = platform.settings.root
    found = [path.stat() for folder in ("uploads", "store/uploads") for path in (root / folder).rglob("*")]
    return sum({facts.st_ino: facts.st_size for facts in found if S_ISREG(facts.st_mode)}.values())


def test_a_file_of_the_same_owner_is_not_sent_again(placed: Platform) -> None:
    owner = make_owner(placed)
    first = complete(placed, owner)
    second = made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert (second.state, second.sha256) == ("complete", sha256_of(BAG))
    assert bytes_in_use(placed) == len(BAG)
    assert used(placed, owner) == 2 * len(BAG)
    terminate(placed, first)
    assert kept(placed, second) == BAG


def test_nobody_learns_from_dedupe_what_others_have(placed: Platform) -> None:
    complete(placed, make_owner(placed))
    upload = made(placed, make_owner(placed, "bob"), BAG, sha256=sha256_of(BAG))
    assert upload.state == "open"
    assert kept(placed, upload) == b""


def test_equal_hashes_with_another_length_are_not_the_same_file(placed: Platform) -> None:
    owner = make_owner(placed)
    complete(placed, owner)
    assert made(placed, owner, BAG + b"x", sha256=sha256_of(BAG)).state == "open"


def test_an_open_upload_with_the_declared_hash_proves_nothing(placed: Platform) -> None:
    owner = make_owner(placed)
    made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert made(placed, owner, BAG, sha256=sha256_of(BAG)).state == "open"


def test_a_recording_of_the_same_owner_is_not_sent_again(placed: Platform) -> None:
    owner = make_owner(placed)
    upload = complete(placed, owner)
    record(placed, owner, upload)
    expire(placed)
    assert kept(placed, upload) == b""
    again = made(placed, owner, BAG, sha256=sha256_of(BAG))
    assert again.state == "complete"
    assert kept(placed, again) == BAG
    assert made(placed, make_owner(placed, "bob"), BAG, sha256=sha256_of(BAG)).state == "open"
