"""The shared workspace of a run: files below `work/<root_id>/`, mirrored on the worker's machine.

**Conventions.** A name is written once per run and the run determines its content, so a second attempt writes the same.
Names follow the rules of object keys; hidden files are ignored. With a folder store the workspace is the store's own
folder. With S3 it is a mirror in the cache; a file equal to its object has the object's modification time.
"""

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import TypeVar

from services.runtime.settings import Settings
from services.runtime.store.folder import FolderStore, make_folder, refusing_full
from services.runtime.store.keys import checked, checked_prefix
from services.runtime.store.protocol import Store, StoredObject
from stone_files.atomic import flush

TRANSFERS = 8
T = TypeVar("T")


class Workspace:
    """The files of the run `root_id`: `pull` a stage's inputs, write below `folder`, `push` its outputs."""

    def __init__(self, store: Store, settings: Settings, root_id: str) -> None:
        self._prefix = checked(f"work/{root_id}") + "/"
        self._store = store
        self.is_in_place = isinstance(store, FolderStore)
        base = store.root if isinstance(store, FolderStore) else settings.root / "cache"
        self._folder = base / "work" / root_id

    @property
    def folder(self) -> Path:
        """The local folder of the files, created at the first use."""
        self._folder.mkdir(parents=True, exist_ok=True)
        return self._folder

    def pull(self, *prefixes: str) -> None:
        """Copy every file whose name starts with one of the prefixes to this machine; "" selects all."""
        for prefix in prefixes:
            checked_prefix(prefix)
        if self.is_in_place:
            return
        os.utime(self.folder)  # in use: keeps the cache from evicting it
        stale = [stored for stored in self._stored(prefixes).values() if not _is_same(self._path(stored.key), stored)]
        _all(self._fetch, stale)

    def push(self, *prefixes: str) -> None:
        """Store every local file whose name starts with one of the prefixes, unless it is stored already.

        After the call the files survive a power cut. Raises `bad_key` if a name cannot be an object's name.
        """
        files = {
            checked(self._prefix + name): self.folder / name for prefix in prefixes for name in self._names(prefix)
        }
        if self.is_in_place:
            _flush_all(self._folder, files.values())
            return
        os.utime(self.folder)
        heads = _list_prefixes(prefixes)
        stored = self._stored(heads)
        new = {key for key, path in files.items() if key not in stored or not _is_same(path, stored[key])}
        _all(lambda key: self._store.write(key, files[key]), new)
        for key, object_ in (self._stored(heads) if new else {}).items():
            if key in new:  # it equals its object: later pulls and pushes skip it
                os.utime(files[key], ns=(object_.modified_ns, object_.modified_ns))

    def delete(self, prefix: str, is_spent: Callable[[str], bool]) -> None:
        """Delete the files with this prefix whose names are spent, here and in the store."""
        for stored in self._stored((checked_prefix(prefix),)).values():
            if is_spent(stored.key.removeprefix(self._prefix)):
                self._store.delete(stored.key)
                self._path(stored.key).unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the files, here and in the store."""
        for stored in list(self._store.listed(self._prefix)):
            self._store.delete(stored.key)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, key: str) -> Path:
        return self._folder / key.removeprefix(self._prefix)

    def _names(self, prefix: str) -> Iterator[str]:
        base, _, head = checked_prefix(prefix).rpartition("/")
        for top in (self.folder / base).glob(f"{head}*"):  # a prefix contains no special character of glob
            for path in (top, *top.rglob("*")):
                name = path.relative_to(self._folder).as_posix()
                if path.is_file() and "/." not in f"/{name}":
                    yield name

    def _fetch(self, stored: StoredObject) -> None:
        """Download beside the target, then rename into place."""
        path = self._path(stored.key)
        partial = path.with_name(f".{token_hex(8)}.partial")
        with refusing_full(self._folder):
            make_folder(path.parent)
            try:
                with partial.open("wb") as file:
                    file.writelines(self._store.read(stored.key))
                os.utime(partial, ns=(stored.modified_ns, stored.modified_ns))
                os.replace(partial, path)
            finally:
                partial.unlink(missing_ok=True)

    def _stored(self, prefixes: Iterable[str]) -> dict[str, StoredObject]:
        return {stored.key: stored for prefix in prefixes for stored in self._store.listed(self._prefix + prefix)}


def _list_prefixes(prefixes: Iterable[str]) -> set[str]:
    """Return the prefixes to list: each folder once, however many of the names it contains."""
    folders = {prefix: prefix[: prefix.rfind("/") + 1] for prefix in prefixes}
    shared = Counter(folders.values())
    return {folder if folder and shared[folder] > 1 else prefix for prefix, folder in folders.items()}


def _is_same(path: Path, stored: StoredObject) -> bool:
    try:
        facts = path.stat()
    except FileNotFoundError:
        return False
    return (facts.st_size, facts.st_mtime_ns) == (stored.size_bytes, stored.modified_ns)


@contextmanager
def fresh_folder(work: Path, prefix: str, ended: Iterable[str] = ()) -> Iterator[Path]:
    """Yield a new folder `<prefix>-<random>`; delete folders of `prefix` and `ended` from earlier attempts.

    After success the folder stays, since stored objects may share its bytes. Raises `StoreFullError`.
    """
    for name in {prefix, *ended}:
        for earlier in work.glob(f"{name}-*"):
            shutil.rmtree(earlier, ignore_errors=True)
    folder = work / f"{prefix}-{token_hex(8)}"
    try:
        with refusing_full(work):
            folder.mkdir()
            yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _all(act: Callable[[T], None], items: Iterable[T]) -> None:
    """Apply `act` to all items, a few at a time; raise the first exception."""
    with ThreadPoolExecutor(TRANSFERS) as pool:
        list(pool.map(act, items))


def _flush_all(folder: Path, files: Iterable[Path]) -> None:
    """Flush the files and the folders that lead to them, several at once for speed."""
    written = list(files)
    _all(flush, written)
    _all(flush, {folder, *(above for path in written for above in path.parents if above.is_relative_to(folder))})
