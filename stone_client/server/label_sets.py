"""List, compare (by a job of the server) and delete the label sets of a sequence on a server."""

from pathlib import Path

import typer
from rich.table import Table

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.confirmation import PermanentAct
from stone_client.progress import Report
from stone_client.server.ids import chosen_id, is_id
from stone_client.server.job_following import follow
from stone_client.server.sequences import Item
from stone_client.tables import QUALITY, plain_table, quality_cells, safe_text
from stone_files.atomic import atomic_file


def label_sets_of(api: Api, sequence_id: str) -> list[Item]:
    """Return all label sets, newest first, each with whether it is active."""
    return list(api.pages(f"/sequences/{sequence_id}/label-sets"))


def compare_label_sets(api: Api, sequence: Item, named: tuple[str, str], progress: Report) -> Item:
    """Return the finished comparison of A and B; an existing comparison is reused.

    Raises `no_label_set`, `JobFailedError`, and what `Api.send` raises.
    """
    ids = [str(item["id"]) for item in label_sets_of(api, sequence["id"])]
    a_id, b_id = (_id_named(name, ids) for name in named)
    if a_id == b_id:
        raise typer.BadParameter(f"A and B are the same label set, {a_id}; name another", param_hint="B")
    accepted = api.create(f"/sequences/{sequence['id']}/label-comparisons", {"a_id": a_id, "b_id": b_id})
    follow(api, accepted["job"]["id"], progress)
    return api.read(f"/sequences/{sequence['id']}/label-comparisons/{accepted['comparison']['id']}")


def label_set_named(api: Api, sequence: Item, named: str) -> str:
    """Return the id of the label set `named`. Raises `no_label_set`, and what `Api.send` raises."""
    return _id_named(named, [str(item["id"]) for item in label_sets_of(api, sequence["id"])])


def deletion(sequence: Item, label_set_id: str) -> PermanentAct:
    act = f"delete label set {label_set_id} of {sequence['name']}"
    return PermanentAct(act, "its frames, maps and pictures cannot be restored")


def delete_label_set(api: Api, sequence: Item, named: str) -> str:
    """Delete the label set and return its id. Raises `no_label_set`, and what `Api.send` raises."""
    label_set_id = label_set_named(api, sequence, named)
    api.send("DELETE", f"/sequences/{sequence['id']}/label-sets/{label_set_id}")
    return label_set_id


def fetch_pictures(api: Api, comparison: Item, folder: Path) -> list[Path]:
    """Save `<frame_token>.png` of the least similar frames: top views of A, B and the difference; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    own = f"/sequences/{comparison['sequence_id']}/label-comparisons/{comparison['id']}"
    written = []
    for frame in comparison["record"]["least_alike"]:
        path = folder / f"{frame['token']}.png"
        content = api.send("GET", f"{own}/frames/{frame['token']}.png").content
        with atomic_file(path) as staging:
            staging.write_bytes(content)
        written.append(path)
    return written


def label_set_table(name: str, sets: list[Item]) -> Table:
    """Return a table with one row per label set."""
    table = plain_table(f"label sets of {safe_text(name)}", "id", "profile", "frames", *QUALITY, "made", "by", "counts")
    for item in sets:
        counts = "yes" if item["is_counting"] else ""
        facts = (
            item["profile"],
            f"{item['frames']:,}",
            *quality_cells(item),
            item["created_at"][:19],
            item["code_version"],
            counts,
        )
        table.add_row(item["id"], *map(safe_text, facts))
    return table


def _id_named(named: str, ids: list[str]) -> str:
    """Return the whole id of `named` from `ids`, newest first. Raises `no_label_set`, `ambiguous_id`."""
    whole = named if is_id(named) else chosen_id(named, ids)
    if whole is None:
        raise Refused(
            "no_label_set",
            f"{named[:80]!r} is not a label set; give an id, or latest, latest~1, … (this sequence has {len(ids)}; "
            "`stone label-set list` lists them)",
        )
    return whole
