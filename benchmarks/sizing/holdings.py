"""A platform's holdings: rows and bytes of its database, bytes of its store by kind, and of its disk."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from services.runtime.orm import Artefact, Blob, Export, ExportPack, JobAttempt, RecordingFile, SubmissionRow
from services.runtime.orm.base import Base
from services.runtime.platform import Platform

MB = 1e6
DATABASE_BYTES = {
    "postgresql": "SELECT pg_database_size(current_database())",
    "sqlite": "SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()",
}


@dataclass(frozen=True)
class PlatformHoldings:
    """Rows by table, `database_bytes` with indexes, `stored_bytes` by kind, and processor time of all jobs."""

    rows: Mapping[str, int]
    database_bytes: int
    stored_bytes: Mapping[str, int]
    cpu_s: float

    def costs_since(self, earlier: "PlatformHoldings") -> dict[str, float]:
        """Return the additions since `earlier`."""
        kinds = dict.fromkeys([*earlier.stored_bytes, *self.stored_bytes])
        stored = {what: self.stored_bytes.get(what, 0) - earlier.stored_bytes.get(what, 0) for what in kinds}
        return {
            "CPU s": self.cpu_s - earlier.cpu_s,
            **{f"{what}, MB": size / MB for what, size in stored.items()},
            "database rows": float(sum(self.rows.values()) - sum(earlier.rows.values())),
            "database MB": (self.database_bytes - earlier.database_bytes) / MB,
        }


def holdings_of(platform: Platform) -> PlatformHoldings:
    """Return the present holdings of a platform."""
    with platform.database.reading() as session:
        rows = {
            table.name: int(session.scalar(select(func.count()).select_from(table)) or 0)
            for table in Base.metadata.sorted_tables
        }
        size = int(session.scalar(text(DATABASE_BYTES[session.get_bind().dialect.name])) or 0)
        cpu_s = float(session.scalar(select(func.sum(JobAttempt.cpu_s))) or 0.0)
        return PlatformHoldings(rows, size, _stored_bytes(session), cpu_s)


def bytes_below(folder: Path) -> int:
    """Return the bytes of all files; a file that vanishes meanwhile counts 0."""
    total = 0
    for path in folder.rglob("*"):
        try:
            status = path.lstat()
        except FileNotFoundError:
            continue
        total += status.st_blocks * 512
    return total


def _stored_bytes(session: Session) -> Mapping[str, int]:
    """Return the bytes of every blob by kind, from the names of artefacts and formats of exports."""
    stored = Counter[str]()
    for name, size in session.execute(select(Artefact.name, Artefact.size_bytes)):
        stored["labels" if name.startswith("labels/") else "map and tables"] += size
    exported = select(Export.format, ExportPack.size_bytes).join(Export, Export.id == ExportPack.export_id)
    for kind, size in session.execute(exported):
        stored[kind] += size
    for what, column in (("recording", RecordingFile.blob_sha256), ("submission", SubmissionRow.blob_sha256)):
        whole = select(func.sum(Blob.size_bytes)).where(Blob.sha256.in_(select(column)))
        stored[what] = int(session.scalar(whole) or 0)
    stored["other files"] = int(session.scalar(select(func.sum(Blob.size_bytes))) or 0) - stored.total()
    return stored
