"""Tables of published results, exactly as printed.

**Conventions.** Percentages keep the characters of the publication, so that 61.2 stays 61.2. Method and modality
together identify a row: two rows of Table II are called OccFusion.

Source: STONE Dataset: A Scalable Multi-Modal Surround-View 3D Traversability Dataset for Off-Road Robot Navigation
(ICRA 2026), Table II.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

from stone_base.errors import Refused

RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")


@dataclass(frozen=True)
class PublishedRow:
    """A method's percentages as printed, in the order of `RATIOS`, None if undefined; `remark` applies to this row
    alone.
    """

    method: str
    modality: str
    percent: tuple[str | None, ...]
    remark: str = ""


@dataclass(frozen=True)
class PublishedTable:
    """A published table; `note` and `kind` (of a reported row in the API) apply to every row."""

    title: str
    source: str
    note: str
    rows: tuple[PublishedRow, ...]
    kind: str = "published"

    def reported(self) -> list[dict[str, Any]]:
        """Return the rows in the form of the API."""
        return [self._row(row) for row in self.rows]

    def _row(self, row: PublishedRow) -> dict[str, Any]:
        printed = [Decimal(value) if value else None for value in row.percent]
        ratios = {name: float(v.scaleb(-2)) if v is not None else None for name, v in zip(RATIOS, printed, strict=True)}
        digits = max(len((value or "").partition(".")[2]) for value in row.percent)
        fields = {"source": self.source, "note": f"{self.note} {row.remark}".rstrip(), "percent_digits": digits}
        return {"method": row.method, "modality": row.modality, "kind": self.kind, **fields, **ratios}


TABLE2 = PublishedTable(
    title="Table II of the STONE paper",
    source="STONE Dataset (ICRA 2026), Table II",
    note=(
        "Published by the paper for its own recordings, of which split it does not say; not scored here, not "
        "comparable with a score on other data."
    ),
    rows=(
        PublishedRow("C-OpenOcc", "C", ("35.0", "14.5", "23.8", "33.7", "24.0")),
        PublishedRow("C-CoNet", "C", ("37.0", "14.8", "24.3", "34.2", "24.4")),
        PublishedRow("OccFormer", "C", ("37.8", "16.3", "29.0", "34.1", "26.5")),
        PublishedRow("TPVFormer", "C", ("39.6", "16.9", "29.6", "35.5", "27.3")),
        PublishedRow("L-OpenOcc", "L", ("61.2", "21.1", "33.4", "55.2", "36.5")),
        PublishedRow("L-CoNet", "L", ("61.6", "22.5", "34.8", "57.0", "38.1")),
        PublishedRow("OccFusion", "C+R", ("45.2", "21.5", "36.4", "41.3", "33.1")),
        PublishedRow("M-OpenOcc", "C+L", ("62.3", "18.1", "35.0", "61.0", "38.0")),
        PublishedRow("M-CoNet", "C+L", ("62.6", "18.3", "36.0", "62.0", "38.8")),
        PublishedRow(
            "OccFusion",
            "C+L",
            ("66.1", "19.0", "36.9", "62.8", "39.6"),
            remark="The paper prints this IoU T of 19.0 in bold although L-CoNet's 22.5 is higher.",
        ),
    ),
)
TABLES: Mapping[str, PublishedTable] = {"table2": TABLE2}


def table_named(name: str) -> PublishedTable:
    """Return the table of this name, or the table in this file of `stone ceiling`. Raises `no_such_table`."""
    if name in TABLES:
        return TABLES[name]
    try:
        read = json.loads(Path(name).read_text("utf-8"))
        rows = tuple(PublishedRow(row["method"], row["modality"], tuple(row["percent"])) for row in read["rows"])
        table = PublishedTable(read["title"], read["source"], read["note"], rows, read["kind"])
        table.reported()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, InvalidOperation) as error:
        raise Refused(
            "no_such_table", f"{name[:200]!r} is neither {', '.join(TABLES)} nor a file that `stone ceiling` wrote"
        ) from error
    return table
