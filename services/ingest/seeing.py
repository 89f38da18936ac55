"""What is seen of a recording by the child that reads it, and what of that its parent believes.

    files → (what was cut off is recovered) → inspection → quality → previews → a parcel

**Conventions.** The child writes the files that it recovers into its folder and answers with everything else. The
parent takes records for what they are, JSON of a bounded size, and a recovered file only where it asked for one.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from services.ingest.apart import Apart
from services.ingest.bag import open_bag
from services.ingest.cut_files import RecoveredFile, recovered_files
from services.ingest.errors import CutBagError
from services.ingest.inspection import Inspection, inspect
from services.ingest.inspection_record import inspection_record
from services.ingest.previews.pictures import previews_of
from services.ingest.quality.page import quality_page
from services.ingest.quality.report import quality_of
from services.ingest.received import Received
from services.runtime.confined import ConfinedCrashedError, Progress
from services.runtime.confined.parcel import File, Parcel, packed, unpacked

QUALITY_RECORD, QUALITY_PAGE = "quality.json", "quality.html"
RECOVERED, NAMES = "recovered", "names"
STEPS = 4


@dataclass(frozen=True)
class Seen:
    """The records of inspection and quality as they are kept in rows; `drawn` are the previews.

    `recovered` are files, by the row of the file that was cut off and in whose place they are read.
    """

    inspection: dict[str, Any]
    quality: dict[str, Any]
    topics: int
    findings: int
    recovered: Mapping[str, Path]
    drawn: tuple[File, ...]


def seen(brought: Received, apart: Apart) -> Seen:
    """Raises the `BAG-*` refusals, `ConfinedCrashedError`, `ConfinedInterruptedError`, `JobCancelledError`."""
    answer = apart.read(partial(_look, brought), "inspect", STEPS)
    return _believed(unpacked(answer), brought, apart.folder)


def _look(brought: Received, folder: Path, progress: Progress) -> bytes:
    """The child's part."""
    ours = replace(brought, folder=folder / NAMES)
    path, recovered = ours.bag(), dict[str, RecoveredFile]()
    try:
        inspection = inspect(path, ours.profile)
    except CutBagError:
        recovered = recovered_files(ours, folder / RECOVERED)
        if not recovered:
            raise
        path = ours.bag({row_id: file.path for row_id, file in recovered.items()})
        inspection = inspect(path, ours.profile)
    said = tuple(file.finding for file in recovered.values())
    inspection = replace(inspection, findings=(*said, *inspection.findings))
    progress("measure", 1, STEPS)
    return _measured(ours.name, path, inspection, list(recovered))


def _measured(name: str, path: Path, inspection: Inspection, recovered: list[str]) -> bytes:
    with open_bag(path) as bag:
        quality = quality_of(bag, inspection)
        pictures = tuple(previews_of(bag, inspection))
    page = quality_page(name, inspection, quality, pictures)
    record = json.dumps(quality.as_record(), indent=1, allow_nan=False).encode()
    told = {
        "inspection": inspection_record(inspection),
        "quality": quality.as_record(),
        "topics": len(inspection.topics),
        "findings": len(inspection.findings),
        "recovered": recovered,
    }
    own = ((QUALITY_RECORD, "application/json", record), (QUALITY_PAGE, "text/html", page))
    return packed(told, (*own, *pictures))


def _believed(parcel: Parcel, brought: Received, folder: Path) -> Seen:
    match parcel.record:
        case {
            "inspection": {"findings": list(), **_inspected} as inspection,
            "quality": {"score": int(), **_measured} as quality,
            "topics": int(topics),
            "findings": int(findings),
            "recovered": list(row_ids),
        } if set(map(str, row_ids)) <= {file.row_id for file in brought.files}:
            recovered = {row_id: _plain(folder / RECOVERED / f"{row_id}.mcap") for row_id in row_ids}
            return Seen(inspection, quality, topics, findings, recovered, parcel.files)
    raise ConfinedCrashedError("answered something else than what was seen")


def _plain(path: Path) -> Path:
    if path.is_symlink() or not path.is_file():
        raise ConfinedCrashedError("recovered no file where it said it did")
    return path
