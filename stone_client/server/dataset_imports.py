"""Imports of published datasets on a server: sent, asked for, followed, listed.

**Conventions.** Nothing is kept on this side. A dataset that is being imported, or was, is not sent again: one's own
import of the same bytes or place with the same options is looked up. The server lists class maps by name alone, so with
a class map only an import that has not ended is continued.
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
    """The options of an import; `classes` is the content of a file that states a class map.

    `layout` is a name and `grid` a record of what is stated.
    """

    name: str
    classes: str | None = None
    existing: str = "refuse"
    sets_splits: bool = False
    is_public: bool = False
    layout: str | None = None
    grid: dict[str, object] | None = None

    def are_of(self, one: Item) -> bool:
        """Whether an import was asked for in this way; of grids the names are compared, of class maps in `_goes_on`."""
        grid = None if self.grid is None else self.grid["name"]
        asked = (self.name, self.existing, self.sets_splits, self.layout, grid)
        return tuple(one[key] for key in ("name", "existing", "sets_splits", "layout", "grid")) == asked


def import_in_place(api: Api, place: Place, wishes: DatasetWishes) -> Item:
    """The import of the archive at the place; one that is under way, or has ended well, is not asked for again.

    Raises `splits_forbidden`, what `Api.create` raises.
    """
    _refuse_splits(api, wishes)
    wanted = {"root": place.root, "path": place.path}
    standing = _standing(api, {"place": wanted}, wishes)
    return standing or api.create(PATH, {"in_place": wanted, **asdict(wishes)})


def send_dataset(api: Api, path: Path, wishes: DatasetWishes, progress: Report) -> Item:
    """The import of the dataset in a folder or a tar, asked for once all of it is on the server.

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
    """One import, with its scenes."""
    return api.read(f"{PATH}/{import_id}")


def imports_of(api: Api) -> Iterator[Item]:
    """One's own imports, newest first; an administrator is told of everybody's."""
    own = api.read("/me")["user_id"]
    return (one for one in api.pages(PATH) if one["owner_id"] == own)


def imports_table(imports: Iterable[Item]) -> Table:
    """A row each: what it is, how far."""
    table = plain_table("imports of datasets", "id", "dataset", "state", "scenes", "frames", "bytes", "created")
    for one in imports:
        counts = _counts(one)
        facts = (f"{one['size_bytes']:,}", one["created_at"][:19])
        table.add_row(one["id"], safe_text(one["name"]), one["state"], *counts, *facts)
    return table


def _counts(one: Mapping[str, Any]) -> tuple[str, str]:
    if one["scenes_total"] is None:
        return DASH, DASH
    return f"{one['scenes_done']:,} of {one['scenes_total']:,}", f"{one['frames']:,}"


def _refuse_splits(api: Api, wishes: DatasetWishes) -> None:
    """Refuse, before anything is hashed or sent, to set the draft splits for who may not."""
    if wishes.sets_splits:
        me = api.read("/me")
        if me["role"] != "administrator" or "admin" not in me["scopes"]:
            raise splits_forbidden()


def _standing(api: Api, archive: Mapping[str, Any], wishes: DatasetWishes) -> Item | None:
    """The import of this archive by these wishes that is under way, or has ended well."""
    for one in imports_of(api):
        is_same = all(one[key] == known for key, known in archive.items()) and wishes.are_of(one)
        if is_same and _goes_on(one, wishes.classes):
            return read_import(api, one["id"])
    return None


def _goes_on(one: Item, classes: str | None) -> bool:
    if classes is None or one["classes"] is None:
        return classes == one["classes"] and one["state"] in (*ALIVE, "succeeded")
    return one["state"] in ALIVE and one["classes"] in classes
