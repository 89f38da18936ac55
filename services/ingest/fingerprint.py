"""What a sequence was made from, as a hash that anybody can recompute (sha256sum)."""

from hashlib import sha256
from pathlib import Path

HASH_BLOCK_BYTES = 1 << 20


def recording_sha256(path: Path) -> str:
    """sha256 of the file; of a folder, of its files' names and hashes in order of name."""
    if path.is_dir():
        parts = (f"{recording_sha256(file)}  {file.name}\n" for file in sorted(path.iterdir()) if file.is_file())
        return sha256("".join(parts).encode()).hexdigest()
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
