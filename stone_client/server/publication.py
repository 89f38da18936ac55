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
    """Return what `publish_dataset` would publish: the draft splits, findings about them, and flagged label sets."""
    draft = current(api)
    entries = {part: draft[part] for part in PARTS}
    parts = {
        part: {"sequences": [one["name"] for one in held], "frames": sum(one["frames"] for one in held)}
        for part, held in entries.items()
    }
    flagged = [one for held in entries.values() for one in held if one["gravest"]]
    return {
        "name": name,
        "licence": licence,
        "revision": draft["revision"],
        "parts": parts,
        "flagged": [{key: one[key] for key in ("name", "held_out_recall", "gravest")} for one in flagged],
        "findings": draft["findings"] or [],
    }


def publishing(plan: Mapping[str, Any]) -> PermanentAct:
    """The act of publishing the plan of `planned_version`."""
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
        for one in plan["flagged"]:
            table.add_row(safe_text(one["name"]), *map(safe_text, quality_cells(one)))
        show(table)
    _echo_rules(plan["findings"])


def planned_splits(api: Api, path: Path) -> dict[str, Any]:
    """Return the difference between the splits of a file and the saved draft, and what the rules find.

    Raises `bad_splits_file`, `not_found`, `ambiguous_name`, and what `Api.send` raises.
    """
    draft = current(api)
    ids, revision = wanted_splits(draft, path)
    names = {one["sequence_id"]: one["name"] for part in (*PARTS, "unassigned") for one in draft[part]}
    before = {one["sequence_id"]: part for part in PARTS for one in draft[part]}
    after = {one: part for part in PARTS for one in ids[part]}
    changes = [
        {"sequence": names[one], "from": before.get(one), "to": after.get(one)}
        for one in names
        if before.get(one) != after.get(one)
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
    """The act of saving the plan of `planned_splits`."""
    sizes = ", ".join(f"{part} {size}" for part, size in plan["sizes"].items())
    moved = counted(len(plan["changes"]), "sequence")
    act = f"save splits ({sizes}) over the draft of revision {plan['revision']}; {moved} would move to another split"
    return PermanentAct(act, "the platform keeps no earlier draft")


def show_splits_plan(plan: Mapping[str, Any], *, as_json: bool) -> None:
    """Print each sequence that changes its part on stdout, unless under `--json`, and findings on stderr."""
    if plan["changes"] and not as_json:
        table = plain_table("changes", "sequence", "from", "to")
        for one in plan["changes"]:
            table.add_row(safe_text(one["sequence"]), one["from"] or "unassigned", one["to"] or "unassigned")
        show(table)
    _echo_rules(plan["findings"])


def _echo_rules(rules: Sequence[Item]) -> None:
    echo_findings(Finding(rule["code"], rule["severity"], "", rule["message"]) for rule in rules)
