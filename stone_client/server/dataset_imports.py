"""Imports of published datasets on a server: uploaded, requested, followed, listed.

**Conventions.** The client stores nothing. It looks up the caller's import of the same bytes or place with the same
options, and does not send the dataset again. The server lists only the names of class maps, so with a class map only an
unfinished import is continued.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from stone_base.errors import splits_forbidden
from stone_client.api import Api
from stone_client.files.datasets import hashed_dataset
from stone_client.files.tus import Purpose, upload_file
from stone_client.progress import Report
from stone_client.server.places import Place
from stone_client.server.sequences import Item
from stone_client.tables import DASH, plain_table, safe_text

PATH = "/dataset-imports"
ALIVE = ("queued", "running")


@dataclass(frozen=True)
class DatasetWishes:
    """The options of an import; `classes` is the content of a file with a class map.

    `layout` is a name and `grid` a record, if given.
    """

    name: str
    classes: str | None = None
    existing: str = "refuse"
    sets_splits: bool = False
    is_public: bool = False
    layout: str | None = None
    grid: dict[str, object] | None = None

    def are_of(self, item: Item) -> bool:
        """Return whether an import has these options; grids are compared by name, class maps in `_goes_on`."""
        grid = None if self.grid is None else self.grid["name"]
        wanted = (self.name, self.existing, self.sets_splits, self.layout, grid)
        return tuple(item[key] for key in ("name", "existing", "sets_splits", "layout", "grid")) == wanted


def import_in_place(api: Api, place: Place, wishes: DatasetWishes) -> Item:
    """Return the import of the archive at the place; an unfinished or successful import is reused.

    Raises `splits_forbidden`, what `Api.create` raises.
    """
    _refuse_splits(api, wishes)
    wanted = {"root": place.root, "path": place.path}
    standing = _standing(api, {"place": wanted}, wishes)
    return standing or api.create(PATH, {"in_place": wanted, **asdict(wishes)})


def send_dataset(api: Api, path: Path, wishes: DatasetWishes, progress: Report) -> Item:
    """Upload the dataset in a folder or a tar, request its import and return it.

    Raises `splits_forbidden`, a `DatasetFaultError`, `bad_tar`, `file_changed`, and what `Api.send` raises.
    """
    _refuse_splits(api, wishes)
    local = hashed_dataset(path, progress)
    standing = _standing(api, {"place": None, "sha256": local.sha256}, wishes)
    if standing is not None:
        return standing
    upload_id = upload_file(api, local, Purpose("dataset"), progress)
    return api.create(PATH, {"upload_id": upload_id, **asdict(wishes)})


def read_import(api: Api, import_id: str) -> Item:
    """Return one import, with its scenes."""
    return api.read(f"{PATH}/{import_id}")


def imports_of(api: Api) -> Iterator[Item]:
    """Yield the caller's imports, newest first; for an administrator the imports of all users."""
    own = api.read("/me")["user_id"]
    return (item for item in api.pages(PATH) if item["owner_id"] == own)


def imports_table(imports: Iterable[Item]) -> Table:
    """Return a table with one row per import: its kind and progress."""
    table = plain_table("imports of datasets", "id", "dataset", "state", "scenes", "frames", "bytes", "created")
    for item in imports:
        counts = _counts(item)
        facts = (f"{item['size_bytes']:,}", item["created_at"][:19])
        table.add_row(item["id"], safe_text(item["name"]), item["state"], *counts, *facts)
    return table


def _counts(item: Mapping[str, Any]) -> tuple[str, str]:
    if item["scenes_total"] is None:
        return DASH, DASH
    return f"{item['scenes_done']:,} of {item['scenes_total']:,}", f"{item['frames']:,}"


def _refuse_splits(api: Api, wishes: DatasetWishes) -> None:
    """Refuse to set the draft splits without the required role, before anything is hashed or sent."""
    if wishes.sets_splits:
        me = api.read("/me")
        if me["role"] != "administrator" or "admin" not in me["scopes"]:
            raise splits_forbidden()


def _standing(api: Api, archive: Mapping[str, Any], wishes: DatasetWishes) -> Item | None:
    """Return the unfinished or successful import of this archive with these options."""
    for item in imports_of(api):
        is_same = all(item[key] == known for key, known in archive.items()) and wishes.are_of(item)
        if is_same and _goes_on(item, wishes.classes):
            return read_import(api, item["id"])
    return None


def _goes_on(item: Item, classes: str | None) -> bool:
    if classes is None or item["classes"] is None:
        return classes == item["classes"] and item["state"] in (*ALIVE, "succeeded")
    return item["state"] in ALIVE and item["classes"] in classes
