"""What a sequence was made from, as a hash that anybody can recompute (sha256sum)."""

from hashlib import sha256
from pathlib import Path

from services.runtime.bag_files import LEFT_BESIDE, is_bag_part, whole_sha256

HASH_BLOCK_BYTES = 1 << 20


def bag_parts(path: Path) -> list[Path]:
    """The files that are the bag, by name: of a rosbag2 folder, or a file and what its recorder left beside it."""
    if not path.is_dir():
        return [path, *(beside for suffix in LEFT_BESIDE if _has_bytes(beside := path.with_name(path.name + suffix)))]
    parts = sorted(file for file in path.iterdir() if file.is_file() and is_bag_part(file.name))
    return [part for part in parts if _has_bytes(part) or not part.name.endswith(LEFT_BESIDE)]


def recording_sha256(path: Path) -> str:
    """sha256 of the file; of several, of their names and hashes in order of name."""
    if path.is_dir() or len(bag_parts(path)) > 1:
        return whole_sha256((part.name, _file_sha256(part)) for part in bag_parts(path))
    return _file_sha256(path)


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _file_sha256(path: Path) -> str:
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
