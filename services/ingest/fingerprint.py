"""What a sequence was made from, as a hash that anybody can recompute (sha256sum)."""

from hashlib import sha256
from pathlib import Path

from services.runtime.bag_files import is_bag_part, whole_sha256

HASH_BLOCK_BYTES = 1 << 20


def bag_parts(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder that are the bag, by name; other files may lie beside them."""
    return sorted(file for file in folder.iterdir() if file.is_file() and is_bag_part(file.name))


def recording_sha256(path: Path) -> str:
    """sha256 of the file; of a folder, of the names and hashes of what in it is part of the bag, in order of name."""
    if path.is_dir():
        return whole_sha256((file.name, recording_sha256(file)) for file in bag_parts(path))
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
