"""Versions of the dataset on a server: listed, published, downloaded so that nothing is fetched twice."""

from collections.abc import Mapping
from hashlib import file_digest
from pathlib import Path
from typing import Any
from urllib.parse import quote

import typer

from stone_client.api import Api
from stone_client.progress import Report
from stone_client.server.exports import download_file
from stone_client.server.sequences import Item
from stone_client.tables import plain_table, safe_text, show


def read_datasets(api: Api) -> list[Item]:
    """All of them, newest first."""
    return list(api.pages("/datasets"))


def read_dataset(api: Api, version: str) -> dict[str, Any]:
    record: dict[str, Any] = api.read(f"/datasets/{quote(version, safe='')}")
    return record


def publish_dataset(api: Api, version: str, licence: str, reason: str) -> dict[str, Any]:
    """The version that was made of the splits."""
    record: dict[str, Any] = api.create("/datasets", {"name": version, "licence": licence, "reason": reason})
    return record


def download_dataset(api: Api, dataset: Item, folder: Path, progress: Report) -> list[dict[str, Any]]:
    """Fetch the manifest and the tar of each part that is open, as far as they are not there; what is there now.

    Raises `DamagedDownloadError`, `DownloadUnderWayError`, and what `fetch` raises.
    """
    own, name = f"/datasets/{dataset['name']}", dataset["name"]
    manifest = {"size_bytes": dataset["manifest_bytes"], "sha256": dataset["manifest_sha256"]}
    wanted = [(f"{own}/manifest", f"{name}.manifest.json", manifest)]
    for part in dataset["parts"]:
        tar = {"size_bytes": part["tar_bytes"], "sha256": part["tar_sha256"]}
        wanted.append((f"{own}/archives/{part['part']}", f"{name}-{part['part']}.tar", tar))
    made = []
    for path, called, promised in wanted:
        output = folder / called
        is_there = output.is_file() and _sha256(output) == promised["sha256"]
        begun_bytes = promised["size_bytes"] if is_there else download_file(api, path, promised, output, progress)
        made.append({**promised, "output": str(output), "resumed_at_bytes": begun_bytes})
    return made


def show_datasets(record: Mapping[str, Any]) -> None:
    """A table of versions, or of the sequences of one; the files that were fetched."""
    if "datasets" in record:
        _show_versions(record["datasets"])
        return
    _show_versions([record])
    table = plain_table("sequences", "name", "split", "environment", "illumination", "region", "frames")
    for one in record["sequences"]:
        said = (safe_text(one[key]) for key in ("split", "environment", "illumination", "region"))
        table.add_row(safe_text(one["name"]), *said, f"{one['frames']:,}")
    show(table)
    for finding in record.get("findings", ()):
        typer.echo(f"{finding['severity']} {safe_text(finding['code'])}: {safe_text(finding['message'])}", err=True)
    for file in record.get("files", ()):
        typer.echo(f"{file['output']} ({file['size_bytes']:,} bytes, sha256 {file['sha256']})")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def _show_versions(datasets: list[Item] | list[Mapping[str, Any]]) -> None:
    table = plain_table("dataset", "version", "train", "val", "test", "licence", "published")
    for one in datasets:
        sizes = (str(one["sizes"][part]) for part in ("train", "val", "test"))
        table.add_row(safe_text(one["name"]), *sizes, safe_text(one["licence"]), one["created_at"][:19])
    show(table)
