"""Versions of the dataset on a server: listed, published, and downloaded without repetition."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import typer

from stone_base.counts import counted
from stone_base.findings import Finding
from stone_client.api import Api
from stone_client.progress import Report
from stone_client.server.exports import complete_file
from stone_client.server.sequences import Item
from stone_client.streams import echo_findings
from stone_client.tables import QUALITY, plain_table, quality_cells, safe_text, show


def read_datasets(api: Api) -> list[Item]:
    """Return all versions, newest first."""
    return list(api.pages("/datasets"))


def read_dataset(api: Api, version: str) -> dict[str, Any]:
    return api.read(f"/datasets/{quote(version, safe='')}")


def publish_dataset(api: Api, version: str, licence: str, reason: str, revision: int | None = None) -> dict[str, Any]:
    """Publish the draft splits as a version; with `revision` only that draft. Raises what `Api.send` raises."""
    return api.create("/datasets", {"name": version, "licence": licence, "reason": reason}, revision)


def download_dataset(api: Api, dataset: Item, folder: Path, progress: Report) -> list[dict[str, Any]]:
    """Download the manifest and the missing tars of the open parts; return a record of all files.

    Raises `damaged_download`, `download_under_way`, and what `fetch` raises.
    """
    own, name = f"/datasets/{dataset['name']}", dataset["name"]
    manifest = {"size_bytes": dataset["manifest_bytes"], "sha256": dataset["manifest_sha256"]}
    wanted = [(f"{own}/manifest", f"{name}.manifest.json", manifest)]
    for part in dataset["parts"]:
        tar = {"size_bytes": part["tar_bytes"], "sha256": part["tar_sha256"]}
        wanted.append((f"{own}/archives/{part['part']}", f"{name}-{part['part']}.tar", tar))
    return [complete_file(api, path, promised, folder / called, progress) for path, called, promised in wanted]


def download_dataset_inputs(api: Api, dataset: Item, folder: Path, progress: Report) -> list[dict[str, Any]]:
    """Download the missing tars of the sequences of train and val to `<folder>/inputs/<split>/`, as far as they exist.

    Return each sequence with its state, and with its file if it is ready. Raises what `download_dataset` raises.
    """
    own = f"/datasets/{dataset['name']}/inputs"
    made = []
    for item in list(api.pages(own)):
        record = {"name": item["name"], "split": item["split"], "state": item["state"]}
        if item["state"] == "ready":
            wanted = {"size_bytes": item["tar_bytes"], "sha256": item["tar_sha256"]}
            output = folder / "inputs" / item["split"] / f"{item['name']}.tar"
            record |= complete_file(api, f"{own}/{quote(item['name'], safe='')}.tar", wanted, output, progress)
        made.append(record)
    return made


def show_datasets(record: Mapping[str, Any]) -> None:
    """Print a table of versions, or of the sequences of a version, and the downloaded files."""
    if "datasets" in record:
        _show_versions(record["datasets"])
        return
    _show_versions([record])
    table = plain_table("sequences", "name", "split", "environment", "illumination", "region", "frames", *QUALITY)
    for sequence in record["sequences"]:
        texts = (safe_text(sequence[key]) for key in ("split", "environment", "illumination", "region"))
        table.add_row(
            safe_text(sequence["name"]), *texts, f"{sequence['frames']:,}", *map(safe_text, quality_cells(sequence))
        )
    show(table)
    rules = record.get("findings", ())
    echo_findings(Finding(rule["code"], rule["severity"], "", rule["message"]) for rule in rules)
    for file in (*record.get("files", ()), *record.get("inputs", ())):
        if "output" in file:
            typer.echo(f"{file['output']} ({file['size_bytes']:,} bytes, sha256 {file['sha256']})")
    _show_missing(record.get("inputs", ()))


def _show_missing(inputs: Iterable[Mapping[str, Any]]) -> None:
    """Print which inputs are not created yet, and which are lost."""
    words = {
        "missing": "not created yet; run this again later",
        "lost": "lost: their recordings were deleted",
    }
    for state, why in words.items():
        if names := [safe_text(item["name"]) for item in inputs if item["state"] == state]:
            typer.echo(f"inputs of {counted(len(names), 'sequence')} are {why}: {', '.join(names)}", err=True)


def _show_versions(datasets: list[Item] | list[Mapping[str, Any]]) -> None:
    table = plain_table("dataset", "version", "train", "val", "test", "licence", "published")
    for version in datasets:
        sizes = (str(version["sizes"][part]) for part in ("train", "val", "test"))
        table.add_row(safe_text(version["name"]), *sizes, safe_text(version["licence"]), version["created_at"][:19])
    show(table)
