"""The hash of a recording is sha256sum's, whoever computes it and whatever else is done meanwhile."""

from hashlib import sha256
from pathlib import Path

import pytest

from stone_files.bag_fingerprint import HASH_BLOCK_BYTES, hashed_meanwhile, recording_sha256


@pytest.mark.parametrize("size", [0, 1, HASH_BLOCK_BYTES, 2 * HASH_BLOCK_BYTES + 7])
def test_it_is_that_of_the_bytes(tmp_path: Path, size: int) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(bytes(range(256)) * (size // 256) + b"x" * (size % 256))
    with hashed_meanwhile(path) as found:
        assert found() == {path.name: recording_sha256(path)} == {path.name: sha256(path.read_bytes()).hexdigest()}


def test_what_is_known_is_not_computed_again(tmp_path: Path) -> None:
    with hashed_meanwhile(tmp_path / "gone.mcap", "ab" * 32) as found:
        assert found() == {"gone.mcap": "ab" * 32}


def test_a_file_that_went_away_is_said_where_the_hash_is_asked_for(tmp_path: Path) -> None:
    with hashed_meanwhile(tmp_path / "gone.mcap") as found, pytest.raises(FileNotFoundError):
        found()


def test_a_refusal_does_not_wait_for_the_rest(tmp_path: Path) -> None:
    """Given up before its first block, the hash is of nothing; a sparse file of a terabyte would take many minutes."""
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    assert recording_sha256(path, lambda: True) == sha256(b"").hexdigest()
    with pytest.raises(ZeroDivisionError), hashed_meanwhile(path):
        raise ZeroDivisionError
