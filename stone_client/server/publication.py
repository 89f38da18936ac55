"""The effect of publishing a dataset version or of saving splits, computed before the server changes anything."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stone_base.counts import counted
from stone_base.findings import Finding
from stone_base.names import PARTS
from stone_client.api import Api
from stone_client.confirmation import PermanentAct
from stone_client.server.sequences import Item
from stone_client.server.splits import current, wanted_splits
from stone_client.streams import echo_findings
from stone_client.tables import plain_table, quality_cells, safe_text, show


def planned_version(api: Api, name: str, licence: str) -> dict[str, Any]:
    """Return the content of a publication: the draft splits, findings about them, and flagged label sets."""
    draft = current(api)
    entries = {part: draft[part] for part in PARTS}
    parts = {
        part: {"sequences": [item["name"] for item in held], "frames": sum(item["frames"] for item in held)}
        for part, held in entries.items()
    }
    flagged = [item for held in entries.values() for item in held if item["gravest"]]
    return {
        "name": name,
        "licence": licence,
        "revision": draft["revision"],
        "parts": parts,
        "flagged": [{key: item[key] for key in ("name", "held_out_recall", "gravest")} for item in flagged],
        "findings": draft["findings"] or [],
    }


def publishing(plan: Mapping[str, Any]) -> PermanentAct:
    """Return the act of publishing the plan of `planned_version`."""
    parts = plan["parts"].items()
    sizes = ", ".join(
        f"{part} {counted(len(of['sequences']), 'sequence')} ({of['frames']:,} frames)" for part, of in parts
    )
    licence = f"licence {plan['licence']}" if plan["licence"] else "no licence"
    act = f"publish the draft splits (revision {plan['revision']}) as {plan['name']}, {licence}, with {sizes}"
    return PermanentAct(act, "the version never changes, cannot be deleted and keeps its name")


def show_version_plan(plan: Mapping[str, Any], *, as_json: bool) -> None:
    """Print flagged label sets on stdout, unless under `--json`, and findings on stderr."""
    if plan["flagged"] and not as_json:
        table = plain_table("label sets with a grave finding", "sequence", "held out", "gravest")
        for item in plan["flagged"]:
            table.add_row(safe_text(item["name"]), *map(safe_text, quality_cells(item)))
        show(table)
    _echo_rules(plan["findings"])


def planned_splits(api: Api, path: Path) -> dict[str, Any]:
    """Return the differences between the splits of a file and the saved draft, and the findings of the rules.

    Raises `bad_splits_file`, `not_found`, `ambiguous_name`, and what `Api.send` raises.
    """
    draft = current(api)
    ids, revision = wanted_splits(draft, path)
    names = {entry["sequence_id"]: entry["name"] for part in (*PARTS, "unassigned") for entry in draft[part]}
    before = {entry["sequence_id"]: part for part in PARTS for entry in draft[part]}
    after = {entry: part for part in PARTS for entry in ids[part]}
    changes = [
        {"sequence": names[entry], "from": before.get(entry), "to": after.get(entry)}
        for entry in names
        if before.get(entry) != after.get(entry)
    ]
    verdict = api.create("/splits/verdicts", ids)
    return {
        "revision": revision,
        "sizes": {part: len(ids[part]) for part in PARTS},
        "changes": changes,
        "can_be_put": verdict["can_be_put"] and revision == draft["revision"],
        "findings": verdict["findings"],
    }


def saving(plan: Mapping[str, Any]) -> PermanentAct:
    """Return the act of saving the plan of `planned_splits`."""
    sizes = ", ".join(f"{part} {size}" for part, size in plan["sizes"].items())
    moved = counted(len(plan["changes"]), "sequence")
    act = f"save splits ({sizes}) over the draft of revision {plan['revision']}; {moved} would move to another split"
    return PermanentAct(act, "the platform keeps no earlier draft")


def show_splits_plan(plan: Mapping[str, Any], *, as_json: bool) -> None:
    """Print each sequence that changes its split on stdout, unless under `--json`, and findings on stderr."""
    if plan["changes"] and not as_json:
        table = plain_table("changes", "sequence", "from", "to")
        for change in plan["changes"]:
            table.add_row(safe_text(change["sequence"]), change["from"] or "unassigned", change["to"] or "unassigned")
        show(table)
    _echo_rules(plan["findings"])


def _echo_rules(rules: Sequence[Item]) -> None:
    echo_findings(Finding(rule["code"], rule["severity"], "", rule["message"]) for rule in rules)
