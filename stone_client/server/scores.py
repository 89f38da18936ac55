"""Scores of submissions, as records of the server and as tables for people.

**Conventions.** Ratios are shown in per cent. A dash is a null: undefined, or not visible to the caller yet.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from stone_base.errors import Refused
from stone_client.api import Api
from stone_client.server.benchmarks import phase_path
from stone_client.server.ids import chosen_id, is_id, is_short_id
from stone_client.server.sequences import Item
from stone_client.tables import CLASSES, DASH, READINGS, confusion_table, plain_table, safe_text

RATIOS = {"miou": "mIoU", "iou_occ": "IoU occ", "iou_t": "IoU T", "iou_p": "IoU P", "iou_n": "IoU N"}
EXTRAS = {
    "n_predicted_drivable_ratio": "share of N predicted T or P (dangerous)",
    "n_predicted_t_ratio": "share of N predicted T (dangerous)",
    "t_predicted_n_ratio": "share of T predicted N (over-cautious)",
    "clear_drivable_iou": "IoU of drivable columns, N overhead left out",
    "bev_drivable_iou": "IoU of drivable columns, any N blocks",
}


def submission_id(api: Api, named: str) -> str:
    """Return the whole id of the submission `named`. Raises `no_submission`, `ambiguous_id`.

    An age counts scored submissions only; a short id may also name a validation.
    """
    if is_id(named):
        return named
    own = read_submissions(api)
    scored = [str(item["id"]) for item in own if item["kind"] != "validation"]
    chosen = chosen_id(named, [str(item["id"]) for item in own] if is_short_id(named) else scored)
    if chosen is None:
        raise Refused(
            "no_submission",
            f"{named[:80]!r} is not a submission; give an id, or latest, latest~1, … (your teams have "
            f"{len(scored)}; `stone benchmark results` lists them)",
        )
    return chosen


def read_results(api: Api, submission_id: str) -> dict[str, Any]:
    return api.read(f"/submissions/{submission_id}/results")


def read_breakdown(api: Api, submission_id: str, by: str) -> dict[str, Any]:
    """Return the breakdown of a score; in a hidden phase only after its end."""
    return api.read(f"/submissions/{submission_id}/results/breakdowns", by=by)


def read_submissions(api: Api) -> list[Item]:
    """Return the submissions of the caller's teams, newest first."""
    return list(api.pages("/submissions"))


def compare(api: Api, a: str, b: str) -> dict[str, Any]:
    """Return the differences of two submissions to one phase, with their significance."""
    of = read_results(api, a)
    return api.read(f"{phase_path(of['benchmark'], of['phase'])}/compare", a=a, b=b)


def results_tables(record: Mapping[str, Any]) -> list[Table]:
    """Return the totals with their intervals, then the other visible scores."""
    named = f"{record['method']} ({record['modality']}) in {record['benchmark']} / {record['phase']}"
    table = plain_table(safe_text(named), "", "%", "95 % here", "95 % in unseen places", *READINGS.values())
    readings = [record.get(reading) or {} for reading in READINGS]
    for key, name in RATIOS.items():
        spans = (_told(record, scope, key) for scope in ("these_places", "new_place"))
        table.add_row(name, percent(record["total"][key]), *spans, *(percent(of.get(key)) for of in readings))
    for key, name in EXTRAS.items() if record["extras"] else ():
        table.add_row(name, percent(record["extras"].get(key)), *[DASH] * (2 + len(READINGS)))
    return [table, *([confusion_table(record["confusion"])] if record["confusion"] else [])]


COUNTED = ("traversable", "potentially_traversable", "non_traversable")
"""The keys of voxel counts, in the order of `CLASSES` without free."""


def _told(record: Mapping[str, Any], scope: str, ratio: str) -> str:
    """Return the interval, or the word for its absence."""
    bounds, silence = (((record.get(part) or {}).get(scope) or {}).get(ratio) for part in ("intervals", "silences"))
    return silence.replace("_", " ") if bounds is None and silence else interval(bounds)


def breakdown_table(record: Mapping[str, Any]) -> Table:
    """Return a table with one row per sequence, environment, illumination or ring of distance."""
    names = (*RATIOS.values(), "frames", *(f"{name} voxels" for name in CLASSES[1:]))
    table = plain_table(f"by {record['by']}, %", str(record["by"]), *names)
    for part in record["parts"]:
        counts = (f"{part['frames']:,}", *(f"{part['support'][name]:,}" for name in COUNTED))
        table.add_row(safe_text(part["name"]), *(percent(part["ratios"][key]) for key in RATIOS), *counts)
    return table


def comparison_table(record: Mapping[str, Any]) -> Table:
    """Return a table of A, B and their difference, ratio by ratio."""
    columns = ("A", "B", "A − B", "95 % of A − B", "p", "p in unseen places")
    table = plain_table(f"A {record['a']}  B {record['b']}, %", "", *columns)
    for key, name in RATIOS.items():
        item = record["ratios"][key]
        here, elsewhere = item["these_places"] or {}, item["new_place"] or {}
        values = (percent(item[which]) for which in ("a", "b", "difference"))
        tests = (chance(here.get("p")), chance(elsewhere.get("p")))
        silence = (item.get("silences") or {}).get("these_places") if not here else None
        table.add_row(name, *values, silence.replace("_", " ") if silence else interval(here.get("interval")), *tests)
    return table


def submissions_table(submissions: Sequence[Item]) -> Table:
    table = plain_table("submissions", "id", "method", "track", "kind", "state", "problems", "sent")
    for item in submissions:
        state = f"{item['state']}, withdrawn" if item["withdrawn_at"] else str(item["state"])
        problems = DASH if item["problems_total"] is None else f"{item['problems_total']:,}"
        sent = (item["finalized_at"] or item["created_at"])[:16]
        table.add_row(item["id"], safe_text(item["method"]), item["modality"], item["kind"], state, problems, sent)
    return table


def percent(ratio: float | None, digits: int = 2) -> str:
    return DASH if ratio is None else f"{100 * ratio:.{digits}f}"


def interval(bounds: Sequence[float] | None) -> str:
    return DASH if bounds is None else f"{100 * bounds[0]:.2f} to {100 * bounds[1]:.2f}"


def chance(p: float | None) -> str:
    return DASH if p is None else f"{p:.4f}"
