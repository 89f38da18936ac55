"""The splits on a server: read, proposed, put from a file; as records and as tables.

**Conventions.** A file contains an object with the keys train, val and test, each a list of sequences: names, ids, or
objects with `sequence_id`, as in the server's answers. A file with a `revision` replaces only that revision.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from stone_base.errors import Refused
from stone_base.findings import Finding
from stone_base.names import PARTS
from stone_client.api import Api
from stone_client.errors import unknown_subject
from stone_client.server.sequences import Item
from stone_client.streams import echo_findings
from stone_client.tables import DASH, plain_table, safe_text, show

MOST_BYTES = 16 * 2**20


def bad_splits_file(path: Path, why: str) -> Refused:
    return Refused(
        "bad_splits_file",
        f"{path} contains no splits: {why}; expected an object with the lists train, val and test of sequence names "
        "or ids, as `stone dataset splits propose 31,7,5 --json` prints",
    )


def current(api: Api) -> dict[str, Any]:
    return api.read("/splits")


def proposal(api: Api, sizes: tuple[int, int, int], left_out: Sequence[str]) -> dict[str, Any]:
    """Return a split proposed by the server; nothing is saved. Raises `not_found`, `ambiguous_name`."""
    ids = _ids_of(current(api), left_out) if left_out else []
    return api.create("/splits/proposal", {"sizes": dict(zip(PARTS, sizes, strict=True)), "leave_out": ids})


def put_file(api: Api, path: Path, reason: str, revision: int | None = None) -> dict[str, Any]:
    """Save the splits of a file over the draft of `revision` (None: the file's revision, else the newest).

    Raises `bad_splits_file`, `not_found`, `ambiguous_name`, and what `Api.send` raises.
    """
    body, newest = wanted_splits(current(api), path)
    match = f'"{newest if revision is None else revision}"'
    answer = api.send("PUT", "/splits", json={**body, "reason": reason}, headers={"If-Match": match})
    record: dict[str, Any] = answer.json()
    return record


def wanted_splits(split_now: Item, path: Path) -> tuple[dict[str, list[str]], int]:
    """Return the ids of each split from the file, and the revision that they replace.

    Raises `bad_splits_file`, `not_found`, `ambiguous_name`.
    """
    wanted = _read(path)
    ids: dict[str, list[str]] = {part: _ids_of(split_now, wanted[part]) for part in PARTS}
    revision: int = wanted["revision"] if "revision" in wanted else split_now["revision"]
    return ids, revision


def show_splits(record: Mapping[str, Any], *, as_json: bool) -> None:
    """Print tables of the splits, or of a proposal with its shares; findings go to stderr."""
    if not as_json:
        for part in PARTS:
            _show_part(part, record[part])
        if record.get("unassigned"):
            _show_part("unassigned", record["unassigned"])
        if record.get("shares"):
            _show_shares(record["shares"])
        if record.get("gap"):
            typer.echo(safe_text(record["gap"]["message"]))
    clash, findings = record.get("conflict") or [], record["findings"] or []
    echo_findings(Finding(rule["code"], "error", "", rule["message"]) for rule in clash)
    echo_findings(Finding(rule["code"], rule["severity"], "", rule["message"]) for rule in findings)


def _read(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MOST_BYTES:
        raise bad_splits_file(path, f"it is larger than {MOST_BYTES} bytes")
    try:
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError):
        raise bad_splits_file(path, "it is not JSON") from None
    if not isinstance(content, dict) or not all(isinstance(content.get(part), list) for part in PARTS):
        raise bad_splits_file(path, "a list is missing")
    named: dict[str, Any] = {part: [_named(path, item) for item in content[part]] for part in PARTS}
    revision = content.get("revision")
    return {**named, "revision": revision} if isinstance(revision, int) else named


def _named(path: Path, item: Any) -> str:
    named = item.get("sequence_id") if isinstance(item, dict) else item
    if not isinstance(named, str):
        raise bad_splits_file(path, "a sequence is neither a name nor an id")
    return named


def _ids_of(split_now: Mapping[str, Any], named: Sequence[str]) -> list[str]:
    """Return the ids of sequences given by name or id."""
    entries = [entry for part in (*PARTS, "unassigned") for entry in split_now[part]]
    ids = {entry["sequence_id"] for entry in entries}
    by_name = dict[str, list[str]]()
    for entry in entries:
        by_name.setdefault(entry["name"], []).append(entry["sequence_id"])
    return [name if name in ids else _only(name, by_name.get(name, [])) for name in named]


def _only(name: str, ids: list[str]) -> str:
    if not ids:
        raise unknown_subject(name)
    if len(ids) > 1:
        raise Refused(
            "ambiguous_name",
            f"{len(ids)} sequences are called {name[:100]!r}; give the id instead: {', '.join(ids[:4])}",
        )
    return ids[0]


def _show_part(title: str, entries: Sequence[Item]) -> None:
    table = plain_table(f"{title}: {len(entries)}", "sequence", "environment", "illumination", "region", "s", "frames")
    for entry in entries:
        texts = (safe_text(entry[key]) or DASH for key in ("environment", "illumination", "region"))
        table.add_row(safe_text(entry["name"]), *texts, f"{entry['duration_s']:.0f}", f"{entry['frames']:,}")
    show(table)


def _show_shares(shares: Mapping[str, Any]) -> None:
    table = plain_table("shares", "part", "sequences", "of the time", "T", "P", "N")
    for part in ("whole", *PARTS):
        share = shares[part]
        ratios = share["class_ratios"]
        classes = [f"{100 * ratio:.1f} %" for ratio in ratios.values()] if ratios else [DASH] * 3
        table.add_row(part, str(share["sequences"]), f"{100 * share['duration_ratio']:.1f} %", *classes)
    show(table)
