"""Imports of published datasets on a server: sent, asked for, followed, listed.

**Conventions.** Nothing is kept on this side. A dataset that is being imported, or was, is not sent again: the server
is asked for an import of the same bytes under the same name.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from stone_client.api import Api
from stone_client.files.datasets import hashed_dataset
from stone_client.files.tus import LocalContent, Purpose, upload_file
from stone_client.progress import Report
from stone_client.server.sequences import Item
from stone_client.tables import DASH, plain_table, safe_text

PATH = "/dataset-imports"
ENDED_BADLY = ("failed", "cancelled")


@dataclass(frozen=True)
class DatasetWishes:
    """What an import is to make of a dataset; `classes` is the content of a file that states a class map."""

    name: str
    classes: str | None = None
    existing: str = "refuse"
    sets_splits: bool = False
    is_public: bool = False


def send_dataset(api: Api, path: Path, wishes: DatasetWishes, progress: Report) -> Item:
    """The import of the dataset in a folder or a tar, asked for once all of it is on the server.

    Raises a `DatasetFaultError`, `BadTarError`, `FileChangedError`, and what `Api.send` raises.
    """
    local = hashed_dataset(path, progress)
    standing = _standing(api, local, wishes.name)
    if standing is not None:
        return standing
    upload_id = upload_file(api, local, Purpose("dataset"), progress)
    made: Item = api.create(PATH, {"upload_id": upload_id, **asdict(wishes)})
    return made


def read_import(api: Api, import_id: str) -> Item:
    """One import, with its scenes."""
    found: Item = api.read(f"{PATH}/{import_id}")
    return found


def imports_of(api: Api) -> list[Item]:
    """One's own imports, newest first."""
    return list(api.pages(PATH))


def imports_table(imports: list[Item]) -> Table:
    """A row each: what it is, how far."""
    table = plain_table("imports of datasets", "dataset", "state", "scenes", "frames", "bytes", "begun", "id")
    for one in imports:
        counts = _counts(one)
        facts = (f"{one['size_bytes']:,}", one["created_at"][:19], one["id"])
        table.add_row(safe_text(one["name"]), one["state"], *counts, *facts)
    return table


def _counts(one: Mapping[str, Any]) -> tuple[str, str]:
    if one["scenes_total"] is None:
        return DASH, DASH
    return f"{one['scenes_done']:,} of {one['scenes_total']:,}", f"{one['frames']:,}"


def _standing(api: Api, local: LocalContent, name: str) -> Item | None:
    """The import of these bytes under this name that has not ended badly."""
    for one in api.pages(PATH):
        if (one["sha256"], one["name"]) == (local.sha256, name) and one["state"] not in ENDED_BADLY:
            return read_import(api, one["id"])
    return None
