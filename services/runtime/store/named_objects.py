"""Objects of the store under the file names that their owner gave them.

**Conventions.** A file is a symbolic link `<folder>/<name of the object>/<filename>`; several that are one bag are
links in a folder `<folder>/<hash of names and objects>/<name>/`, and so are several bags that are one run, beside a
file that describes it. The path is the same for every job on this machine, so a recording once opened is found open;
links whose object is gone are removed when others are made. Files that are read in place are linked by `linked_bag`.
"""

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from secrets import token_hex

NAMES_FOLDER = "names"  # below the data folder


def named(folder: Path, path: Path, filename: str) -> Path:
    """A path that ends in `filename` and leads to `path`. Raises `ValueError` where the name is more than a name."""
    _refuse_path(filename)
    link = folder / path.name / filename
    _lead(folder, link, path)
    return link


def named_folder(folder: Path, files: Iterable[tuple[Path, str]], name: str) -> Path:
    """A folder that ends in `name` and holds a link to each of the (path, filename). Raises as `named`."""
    targets = {filename: path for path, filename in files}
    for given in (name, *targets):
        _refuse_path(given)
    lines = sorted(f"{path.name}  {filename}\n" for filename, path in targets.items())
    made = folder / sha256("".join(lines).encode()).hexdigest() / name
    for filename, path in targets.items():
        _lead(folder, made / filename, path)
    return made


def linked_bag(folder: Path, key: str, files: Mapping[str, Path], name: str = "") -> Path:
    """A folder for what `key` names, which holds a link to each of the files (by name), and no other.

    With a `name` it ends in that, for a bag that is a folder. Raises as `named`.
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
    """A folder that ends in `name` and holds a link to each bag, called so, and the file `description` (name, content).

    Bags are paths that `named` or `named_folder` answered. Raises as `named`.
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
    staging = folder / f".{token_hex(8)}"  # beside no bag, or a reader of the folder might meet it
    staging.symlink_to(path)
    os.replace(staging, link)


def _forget_gone(folder: Path) -> None:
    for link in sorted({*folder.glob("*/*"), *folder.glob("*/*/*")}):
        if link.is_symlink() and not link.exists():
            with suppress(OSError):  # another worker may be at it, or other files of the bag are still there
                link.unlink()
                link.parent.rmdir()
                link.parent.parent.rmdir()
