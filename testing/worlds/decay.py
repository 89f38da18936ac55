"""Decay: one bit of a stored file flips."""

from pathlib import Path

from services.runtime.platform import Platform


def flip(path: Path, place: float = 0.5) -> None:
    """Flip a bit at this part of the file, in a copy: an object may share its bytes with the uploaded file."""
    content = bytearray(path.read_bytes())
    content[int(len(content) * place)] ^= 1
    decayed = path.with_name(f".{path.name}.decayed")
    decayed.write_bytes(content)
    decayed.replace(path)


def decay(platform: Platform, object_key: str, place: float = 0.5) -> None:
    """Flip a bit of an object of a folder store, as `flip` does."""
    flip(platform.store.local(object_key), place)
