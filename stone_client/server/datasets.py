"""Versions of the dataset on a server: listed, published, downloaded so that nothing is fetched twice."""

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
    """All of them, newest first."""
    return list(api.pages("/datasets"))


def read_dataset(api: Api, version: str) -> dict[str, Any]:
    return api.read(f"/datasets/{quote(version, safe='')}")


def publish_dataset(api: Api, version: str, licence: str, reason: str, revision: int | None = None) -> dict[str, Any]:
    """Publish the draft splits as a version; with `revision` only that draft. Raises what `Api.send` raises."""
    return api.create("/datasets", {"name": version, "licence": licence, "reason": reason}, revision)


def download_dataset(api: Api, dataset: Item, folder: Path, progress: Report) -> list[dict[str, Any]]:
    """Fetch the manifest and the tar of each part that is open, as far as they are not there; what is there now.

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
    """Fetch the tar of each sequence of train and val, to `<folder>/inputs/<split>/`, as far as it is made; each with
    its state, and with what is there now where it is ready.

    Raises what `download_dataset` raises.
    """
    own = f"/datasets/{dataset['name']}/inputs"
    made = []
    for one in list(api.pages(own)):
        said = {"name": one["name"], "split": one["split"], "state": one["state"]}
        if one["state"] == "ready":
            wanted = {"size_bytes": one["tar_bytes"], "sha256": one["tar_sha256"]}
            output = folder / "inputs" / one["split"] / f"{one['name']}.tar"
            said |= complete_file(api, f"{own}/{quote(one['name'], safe='')}.tar", wanted, output, progress)
        made.append(said)
    return made


def show_datasets(record: Mapping[str, Any]) -> None:
    """A table of versions, or of the sequences of one; the files that were fetched."""
    if "datasets" in record:
        _show_versions(record["datasets"])
        return
    _show_versions([record])
    table = plain_table("sequences", "name", "split", "environment", "illumination", "region", "frames", *QUALITY)
    for one in record["sequences"]:
        said = (safe_text(one[key]) for key in ("split", "environment", "illumination", "region"))
        table.add_row(safe_text(one["name"]), *said, f"{one['frames']:,}", *map(safe_text, quality_cells(one)))
    show(table)
    rules = record.get("findings", ())
    echo_findings(Finding(rule["code"], rule["severity"], "", rule["message"]) for rule in rules)
    for file in (*record.get("files", ()), *record.get("inputs", ())):
        if "output" in file:
            typer.echo(f"{file['output']} ({file['size_bytes']:,} bytes, sha256 {file['sha256']})")
    _show_missing(record.get("inputs", ()))


def _show_missing(inputs: Iterable[Mapping[str, Any]]) -> None:
    """Which inputs are not there yet, and which never will be."""
    words = {
        "missing": "not created yet; run this again later",
        "lost": "lost: their recordings were deleted",
    }
    for state, why in words.items():
        if names := [safe_text(one["name"]) for one in inputs if one["state"] == state]:
            typer.echo(f"inputs of {counted(len(names), 'sequence')} are {why}: {', '.join(names)}", err=True)


def _show_versions(datasets: list[Item] | list[Mapping[str, Any]]) -> None:
    table = plain_table("dataset", "version", "train", "val", "test", "licence", "published")
    for one in datasets:
        sizes = (str(one["sizes"][part]) for part in ("train", "val", "test"))
        table.add_row(safe_text(one["name"]), *sizes, safe_text(one["licence"]), one["created_at"][:19])
    show(table)
