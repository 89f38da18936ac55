"""Objects of the store under their owners' file names.

**Conventions.** A file is a symbolic link `<folder>/<name of the object>/<filename>`. The files of one bag are links in
a folder `<folder>/<hash of names and objects>/<name>/`, as are the bags of one run, beside a file that describes the
run. The path is the same for every job on this machine, so a reader's cache of an opened recording stays valid. Links
whose object is gone are deleted when others are created. `linked_bag` links files that are read in place.
"""

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from secrets import token_hex

NAMES_FOLDER = "names"


def named(folder: Path, path: Path, filename: str) -> Path:
    """Return a path that ends in `filename` and leads to `path`. Raises `ValueError` for a bad file name."""
    _refuse_path(filename)
    link = folder / path.name / filename
    _lead(folder, link, path)
    return link


def named_folder(folder: Path, files: Iterable[tuple[Path, str]], name: str) -> Path:
    """Return a folder that ends in `name` with a link to each (path, filename). Raises as `named`."""
    targets = {filename: path for path, filename in files}
    for given in (name, *targets):
        _refuse_path(given)
    lines = sorted(f"{path.name}  {filename}\n" for filename, path in targets.items())
    made = folder / sha256("".join(lines).encode()).hexdigest() / name
    for filename, path in targets.items():
        _lead(folder, made / filename, path)
    return made


def linked_bag(folder: Path, key: str, files: Mapping[str, Path], name: str = "") -> Path:
    """Return a folder for `key` that contains a link to each of the files (by name), and nothing else.

    With a `name`, the folder's path ends in that name, for a bag that is a folder. Raises as `named`.
    """
    for given in (*files, *([name] if name else [])):
        _refuse_path(given)
    made = folder / sha256(key.encode()).hexdigest() / name
    for gone in {entry.name for entry in made.iterdir() if entry.is_symlink()} - set(files) if made.is_dir() else ():
        (made / gone).unlink(missing_ok=True)
    for filename, path in files.items():
        _lead(folder, made / filename, path)
    return made


def described_folder(folder: Path, bags: Mapping[str, Path], description: tuple[str, bytes], name: str) -> Path:
    """Return a folder that ends in `name` with a named link to each bag, and the file `description` (name, content).

    Bags are paths returned by `named` or `named_folder`. Raises as `named`.
    """
    called, content = description
    for given in (name, called, *bags):
        _refuse_path(given)
    lines = sorted(f"{path.parent.name}  {bag}\n" for bag, path in bags.items())
    made = folder / sha256("".join(lines).encode() + content).hexdigest() / name
    for bag, path in bags.items():
        _lead(folder, made / bag, path)
    if not (made / called).is_file():
        staging = folder / f".{token_hex(8)}"
        staging.write_bytes(content)
        os.replace(staging, made / called)
    return made


def _refuse_path(name: str) -> None:
    if name in ("", ".", "..") or "/" in name:
        raise ValueError(f"{name!r} is not a file name; the upload should have been refused")


def _lead(folder: Path, link: Path, path: Path) -> None:
    if link.is_symlink() and link.readlink() == path:
        return
    _forget_gone(folder)
    link.parent.mkdir(parents=True, exist_ok=True)
    staging = folder / f".{token_hex(8)}"  # outside the bags' folder, where a reader could meet it
    staging.symlink_to(path)
    os.replace(staging, link)


def _forget_gone(folder: Path) -> None:
    for link in sorted({*folder.glob("*/*"), *folder.glob("*/*/*")}):
        if link.is_symlink() and not link.exists():
            with suppress(OSError):  # another worker may use it, or it still has other files of the bag
                link.unlink()
                link.parent.rmdir()
                link.parent.parent.rmdir()
