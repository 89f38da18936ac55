"""A sequence's exports on a server: requested, followed, listed, and downloaded without repetition.

**Conventions.** A partial download is `.<name>.<sha256>.partial` beside the target, locked by its process; the next
download of the same bytes continues it. The target appears whole or not at all.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any

from rich.table import Table

from stone_base.errors import Refused
from stone_base.newer_python import file_digest
from stone_client.api import Api
from stone_client.errors import damaged_download
from stone_client.files.fetch import PartialFile, fetch
from stone_client.progress import Report
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item
from stone_client.tables import DASH, plain_table
from stone_files.atomic import flush
from stone_files.errors import output_exists

ARCHIVES = ("tar", "zip")


def make_export(api: Api, sequence: Item, form: str, progress: Report) -> Item:
    """Return the finished export of the sequence's labels in this format; an existing export is reused.

    Raises `JobFailedError`, and what `Api.send` raises.
    """
    accepted = api.create(f"/sequences/{sequence['id']}/exports", {"format": form})
    follow(api, accepted["job"]["id"], progress)
    return api.read(f"/sequences/{sequence['id']}/exports/{accepted['export']['id']}")


def exports_of(api: Api, sequence: Item) -> list[Item]:
    """Return all exports, newest first."""
    return list(api.pages(f"/sequences/{sequence['id']}/exports"))


def finished_export(api: Api, sequence: Item, form: str) -> Item:
    """Return the export of the active labels. Raises `no_export`."""
    fresh = [item for item in exports_of(api, sequence) if item["format"] == form and not item["is_stale"]]
    for export in fresh:
        if export["state"] == "succeeded":
            return export
    raise no_export(sequence["name"], form, fresh[0]["state"] if fresh else "")


def download_archive(api: Api, export: Item, output: Path, progress: Report) -> dict[str, Any]:
    """Download all files of an export as the archive `output` (`.tar` or `.zip`); return a record of it.

    Raises what `download_file` raises.
    """
    kind = output.suffix[1:]
    wanted = next(archive for archive in export["archives"] if archive["format"] == kind)
    path = f"/sequences/{export['sequence_id']}/exports/{export['id']}/archive?format={kind}"
    begun_bytes = download_file(api, path, wanted, output, progress)
    return {**wanted, "output": str(output), "export": export["id"], "resumed_at_bytes": begun_bytes}


def download_file(api: Api, path: str, wanted: Item, output: Path, progress: Report) -> int:
    """Download `path`, with known `size_bytes` and `sha256`; return the number of bytes that existed before.

    Raises `damaged_download`, `download_under_way`, `output_exists`, and what `fetch` raises.
    """
    if output.exists() and not output.is_file():
        raise output_exists(output, "a folder")
    with _partial(output, wanted["sha256"]) as partial:
        arriving = PartialFile(partial, wanted["sha256"])
        begun_bytes = arriving.size_bytes
        fetch(api, path, arriving, lambda arrived: progress(output.name, arrived, wanted["size_bytes"]))
        if arriving.promised != wanted["sha256"]:
            raise damaged_download(path, arriving.promised, wanted["sha256"])
        flush(partial)
        os.replace(partial, output)
    flush(output.parent)
    return begun_bytes


def complete_file(api: Api, path: str, wanted: Item, output: Path, progress: Report) -> dict[str, Any]:
    """Download `path` unless `output` already has its sha256; return a record of the file.

    Raises what `download_file` raises.
    """
    promised = {"size_bytes": wanted["size_bytes"], "sha256": wanted["sha256"]}
    is_there = output.is_file() and _sha256(output) == promised["sha256"]
    begun_bytes = promised["size_bytes"] if is_there else download_file(api, path, promised, output, progress)
    return {**promised, "output": str(output), "resumed_at_bytes": begun_bytes}


def exports_table(name: str, exports: list[Item]) -> Table:
    """Return a table with one row per export."""
    table = plain_table(f"exports of {name}", "format", "state", "files", "bytes", "made")
    for export in exports:
        state = f"{export['state']}, stale" if export["is_stale"] else export["state"]
        counts = (f"{export['files']:,}", f"{export['size_bytes']:,}") if export["finished_at"] else (DASH, DASH)
        table.add_row(export["format"], state, *counts, (export["finished_at"] or export["created_at"])[:19])
    return table


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def _partial(output: Path, sha256: str) -> Iterator[Path]:
    """Yield the locked partial file for this sha256; remove abandoned partial files of other hashes.

    Raises `download_under_way`.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f".{output.name}.{sha256[:32]}.partial")
    for other in output.parent.glob(f".{escape(output.name)}.*.partial"):
        with suppress(BlockingIOError, FileNotFoundError), _held(other):
            if other != partial:
                other.unlink()
    try:
        with _held(partial, os.O_CREAT):
            yield partial
    except BlockingIOError:
        raise Refused(
            "download_under_way", f"another process is downloading {output}; wait for it, or choose another output path"
        ) from None


@contextmanager
def _held(path: Path, flags: int = 0) -> Iterator[None]:
    descriptor = os.open(path, os.O_RDWR | flags, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def no_export(name: str, form: str, state: str) -> Refused:
    why = f"its {form} export is {state}" if state else f"it has no {form} export of its labels"
    return Refused(
        "no_export",
        f"sequence {name!r} cannot be downloaded in this format: {why}; run "
        f"`stone sequence exports {name} --format {form}`",
    )
