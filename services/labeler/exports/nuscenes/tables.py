"""Tables of the nuScenes schema, written row by row.

**Conventions.** A table is a JSON list with one row per line, so that large tables are written and joined without
holding them in memory. A token is the first 32 hex digits of sha256 over the row's subject, so it is the same in every
export. Source: nuScenes schema (schema_nuscenes.md of nuscenes-devkit 1.2).
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

VERSION = "v1.0-trainval"
TABLES = (
    "attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample", "sample_annotation",
    "sample_data", "scene", "sensor", "visibility",
)  # fmt: skip
# Custom splits of the devkit, the fourteenth file: {split: [scene, …]}.
SPLITS = "splits.json"
Row = Mapping[str, Any]


def token_of(kind: str, *facts: object) -> str:
    """Return 32 hex digits that identify one row of table `kind`."""
    return sha256(json.dumps([kind, *facts], separators=(",", ":")).encode()).hexdigest()[:32]


class NuscenesTableWriter:
    """A table that is being written."""

    def __init__(self, file: IO[str]) -> None:
        self._file, self._count = file, 0
        file.write("[")

    def add(self, row: Row | str) -> None:
        """Add one row, or the line of a row."""
        line = row if isinstance(row, str) else json.dumps(row, separators=(",", ":"), allow_nan=False)
        self._file.write(("," if self._count else "") + "\n" + line)
        self._count += 1

    def end(self) -> None:
        self._file.write("\n]\n")


@contextmanager
def written_tables(folder: Path) -> Iterator[Mapping[str, NuscenesTableWriter]]:
    """Yield all tables by name, each a file `<name>.json` in the folder, which is created."""
    folder.mkdir(parents=True)
    with ExitStack() as files:
        rows = {
            name: NuscenesTableWriter(files.enter_context((folder / f"{name}.json").open("w", encoding="utf-8")))
            for name in TABLES
        }
        yield rows
        for table in rows.values():
            table.end()


def lines_of(table: Path) -> Iterator[str]:
    """Yield the rows of a table written here, as their lines."""
    with table.open(encoding="utf-8") as file:
        for line in file:
            if line.startswith("{"):
                yield line.rstrip("\n").removesuffix(",")


def write_splits(path: Path, scenes: Mapping[str, list[str]]) -> None:
    """Write the devkit's custom splits; the names train, val and test are reserved for the devkit's own splits."""
    path.write_text(json.dumps(scenes, indent=1) + "\n", "utf-8")
