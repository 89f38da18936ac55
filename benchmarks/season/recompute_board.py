"""Recompute both boards of a folder from the stored confusions: `python benchmarks/season/recompute_board.py FOLDER`.

`boards.json` contains the boards `all` and `best` as served to an administrator, `<submission>.npz` the counts of each.
The program imports nothing of the platform. Exit code 1 if order, ranks or any ratio differs.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")


def ratios_of(path: Path, metric: str) -> dict[str, float]:
    counts = np.load(path)["confusions"].sum(axis=(0, 1), dtype=np.int64)
    occupied = counts[1:, 1:].sum() / (counts.sum() - counts[0, 0])
    seen = counts if "occupied" not in metric else counts * np.array([0, 1, 1, 1])[:, None]
    t, p, n = (seen[k, k] / (seen[k].sum() + seen[:, k].sum() - seen[k, k]) for k in (1, 2, 3))
    return dict(zip(RATIOS, map(float, (occupied, t, p, n, (t + p + n) / 3)), strict=True))


def board_of(rows: list[dict[str, Any]]) -> list[tuple[int, str, dict[str, float]]]:
    rows = sorted(rows, key=lambda row: (*row["key"], row["submitted_at"]))
    return [(1 + sum(other["key"] < row["key"] for other in rows), row["submission_id"], row["ratios"]) for row in rows]


boards = json.loads((Path(sys.argv[1]) / "boards.json").read_text())
served = {name: [row for row in board["rows"] if row["standing"] == "ranked"] for name, board in boards.items()}
entries = []
for row in served["all"]:
    ratios = ratios_of(Path(sys.argv[1]) / f"{row['submission_id']}.npz", boards["all"]["pair"]["metric"])
    entries.append(row | {"ratios": ratios, "key": tuple(-round(ratios[k], 4) for k in ("miou", "iou_occ", "iou_n"))})
ordered = sorted(entries, key=lambda row: (*row["key"], row["submitted_at"]))
best = list({row["team"]: row for row in reversed(ordered)}.values())
equal = [board_of(made) == [(row["rank"], row["submission_id"], row["ratios"]) for row in served[name]]
         for name, made in (("all", entries), ("best", best))]  # fmt: skip
print(f"{len(entries)} entries recomputed; equal to the board of all: {equal[0]}, of the best: {equal[1]}")
sys.exit(not all(equal))
