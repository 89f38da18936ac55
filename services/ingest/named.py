"""An object of the store under the name that its owner gave it, for what is said about it and for readers of names.

**Conventions.** A symbolic link `<folder>/<name of the object>/<filename>`. The path is the same for every job on this
machine, so a recording once opened is found open; links whose object is gone are removed when another is made.
"""

import os
from contextlib import suppress
from pathlib import Path
from secrets import token_hex


def named(folder: Path, path: Path, filename: str) -> Path:
    """A path that ends in `filename` and leads to `path`. Raises `ValueError` where the name is more than a name."""
    if filename in ("", ".", "..") or "/" in filename:
        raise ValueError(f"{filename!r} is no name of a file; whoever let it in should have refused it")
    link = folder / path.name / filename
    if not (link.is_symlink() and link.readlink() == path):
        _forget_gone(folder)
        link.parent.mkdir(parents=True, exist_ok=True)
        staging = link.with_name(f".{token_hex(8)}")
        staging.symlink_to(path)
        os.replace(staging, link)
    return link


def _forget_gone(folder: Path) -> None:
    for link in sorted(folder.glob("*/*")):
        if link.is_symlink() and not link.exists():
            with suppress(OSError):  # another worker may be at it
                link.unlink()
                link.parent.rmdir()
