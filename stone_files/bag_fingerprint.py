"""The fingerprint of a sequence's inputs: a hash that anybody can recompute (sha256sum)."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from threading import Event

from stone_files.bag_files import LEFT_BESIDE, is_bag_part, whole_sha256

HASH_BLOCK_BYTES = 1 << 20


def bag_parts(path: Path) -> list[Path]:
    """The files that are the bag, by name: of a rosbag2 folder, or a file and what its recorder left beside it."""
    if not path.is_dir():
        return [path, *(beside for suffix in LEFT_BESIDE if _has_bytes(beside := path.with_name(path.name + suffix)))]
    parts = sorted(file for file in path.iterdir() if file.is_file() and is_bag_part(file.name))
    return [part for part in parts if _has_bytes(part) or not part.name.endswith(LEFT_BESIDE)]


def bag_paths(path: Path) -> tuple[Path, ...]:
    """The bag and its files: a folder may be of links, and whoever may read it may not for that read what they name."""
    return (path, *bag_parts(path))


def recording_sha256(path: Path, is_given_up: Callable[[], bool] = lambda: False) -> str:
    """sha256 of the file; of several, of their names and hashes in order of name; nothing of use once given up."""
    if path.is_dir() or len(bag_parts(path)) > 1:
        return whole_sha256((part.name, _file_sha256(part, is_given_up)) for part in bag_parts(path))
    return _file_sha256(path, is_given_up)


@contextmanager
def hashed_meanwhile(path: Path, known: str | None = None) -> Iterator[Callable[[], str]]:
    """The recording is hashed by another thread while it is read, unless its hash is known; asking for it waits.

    Whoever leaves without having asked, because the recording is refused, does not wait for the rest.
    """
    if known:
        yield lambda: known
        return
    given_up = Event()
    with ThreadPoolExecutor(1) as beside:
        found = beside.submit(recording_sha256, path, given_up.is_set)
        try:
            yield found.result
        finally:
            given_up.set()


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _file_sha256(path: Path, is_given_up: Callable[[], bool]) -> str:
    digest, block = sha256(), bytearray(HASH_BLOCK_BYTES)
    with path.open("rb", buffering=0) as file:
        while not is_given_up() and (size := file.readinto(block)):
            digest.update(memoryview(block)[:size])
    return digest.hexdigest()
