"""Shared files of an export folder, merged from its sequences.

**Conventions.** nuScenes, with labels or without: each sequence's own tables lie in `tables/<sequence>/`, the dataset's
in `v1.0-trainval/` are theirs one after the other, a row that several bring (a sensor, a class) once. SemanticKITTI: a
sequence is a number. Other formats share nothing. The result does not depend on the order in which nuScenes sequences
were added.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from services.labeler.exports.kitti import SEQUENCES, write_config
from services.labeler.exports.nuscenes.tables import (
    SPLITS,
    TABLES,
    VERSION,
    NuscenesTableWriter,
    lines_of,
    write_splits,
)

OWN_TABLES = "tables"
TABLED = ("nuscenes", "inputs")
SHARED_TABLES = frozenset({"attribute", "category", "sensor", "visibility"})


def rearrange(format_name: str, fresh: Path, sequence: str, number: int) -> None:
    """Move what an exporter wrote for a sequence alone to where it does not meet other sequences' files."""
    if format_name in TABLED:
        (fresh / OWN_TABLES).mkdir()
        (fresh / VERSION).rename(fresh / OWN_TABLES / sequence)
        (fresh / OWN_TABLES / sequence / SPLITS).unlink()
    if format_name == "kitti":
        (fresh / SEQUENCES / "00").rename(fresh / SEQUENCES / f"{number:02d}")
        for config in fresh.glob("*.yaml"):
            config.unlink()


def join(format_name: str, folder: Path, numbers: Mapping[str, int]) -> None:
    """Write what these sequences (name → number) share."""
    if format_name in TABLED:
        (folder / VERSION).mkdir()
        for table in TABLES:
            _join_table(folder, table, numbers)
        write_splits(folder / VERSION / SPLITS, {"all": sorted(numbers)})
    if format_name == "kitti":
        write_config(folder, numbers)


def _join_table(folder: Path, table: str, numbers: Mapping[str, int]) -> None:
    seen = set[str]()
    with (folder / VERSION / f"{table}.json").open("w", encoding="utf-8") as file:
        rows = NuscenesTableWriter(file)
        for sequence in sorted(numbers):
            for line in lines_of(folder / OWN_TABLES / sequence / f"{table}.json"):
                if table in SHARED_TABLES and (token := json.loads(line)["token"]) in seen:
                    continue
                if table in SHARED_TABLES:
                    seen.add(token)
                rows.add(line)
        rows.end()
