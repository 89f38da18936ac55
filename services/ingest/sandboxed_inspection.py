"""The inspection of a recording in a sandboxed process, and the checks of what that process answers.

    files → (what was cut off is recovered) → inspection → quality → previews → a parcel

**Conventions.** The child writes the files that it recovers into its folder and answers with everything else. The
parent takes records for what they are, JSON of a bounded size, and a recovered file only where it asked for one.
"""

import json
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from services.ingest.cut_files import RecoveredFile, recovered_files
from services.ingest.outlook import inspected_in
from services.ingest.received_files import ReceivedBag
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.result_files import File, SandboxResult, packed, unpacked
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import CutBagError
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.inspection_record import inspection_record
from stone_recordings.report.previews.pictures import previews_of
from stone_recordings.report.quality.page import quality_page
from stone_recordings.report.quality.report import quality_of
from stone_recordings.report.quality.sampling import SampledMessages

QUALITY_RECORD, QUALITY_PAGE = "quality.json", "quality.html"
RECOVERED, NAMES = "recovered", "names"
STEPS = 4


@dataclass(frozen=True)
class RecordingSurvey:
    """The records of inspection and quality as they are kept in rows; `drawn` are the previews.

    `recovered` are files, by the row of the file that was cut off and in whose place they are read.
    """

    inspection: dict[str, Any]
    quality: dict[str, Any]
    topics: int
    findings: int
    recovered: Mapping[str, Path]
    drawn: tuple[File, ...]


def seen(brought: ReceivedBag, apart: JobSandbox) -> RecordingSurvey:
    """Raises the `BAG-*` refusals, `SandboxCrashedError`, `ConfinedInterruptedError`, `JobCancelledError`."""
    answer = apart.run(partial(_look, brought), "inspect", STEPS)
    return _believed(unpacked(answer), brought, apart.folder)


def _look(brought: ReceivedBag, folder: Path, progress: ProgressCallback) -> bytes:
    """The child's part."""
    ours = replace(brought, folder=folder / NAMES)
    with ExitStack() as files:
        bag, inspection, recovered = _inspected_in(files, ours, folder / RECOVERED)
        said = tuple(file.finding for file in recovered.values())
        inspection = replace(inspection, findings=(*said, *inspection.findings))
        progress("measure", 1, STEPS)
        return _measured(ours.name, bag, inspection, list(recovered))


def _inspected_in(
    files: ExitStack, ours: ReceivedBag, folder: Path
) -> tuple[Bag, Inspection, dict[str, RecoveredFile]]:
    """The recording, open as long as `files` are, and its inspection; what was cut off of it is recovered first."""
    try:
        bag = files.enter_context(open_bag(ours.bag()))
        return bag, inspected_in(bag, ours.profile), {}
    except CutBagError:
        recovered = recovered_files(ours, folder)
        if not recovered:
            raise
    files.close()
    bag = files.enter_context(open_bag(ours.bag({row_id: file.path for row_id, file in recovered.items()})))
    return bag, inspected_in(bag, ours.profile), recovered


def _measured(name: str, bag: Bag, inspection: Inspection, recovered: list[str]) -> bytes:
    sampled = SampledMessages(bag)
    quality = quality_of(bag, inspection, sampled)
    pictures = tuple(previews_of(bag, inspection, sampled))
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


def _believed(parcel: SandboxResult, brought: ReceivedBag, folder: Path) -> RecordingSurvey:
    match parcel.record:
        case {
            "inspection": {"findings": list(), **_inspected} as inspection,
            "quality": {"score": int(), **_measured} as quality,
            "topics": int(topics),
            "findings": int(findings),
            "recovered": list(row_ids),
        } if set(map(str, row_ids)) <= {file.row_id for file in brought.files}:
            recovered = {row_id: _plain(folder, f"{RECOVERED}/{row_id}.mcap") for row_id in row_ids}
            return RecordingSurvey(inspection, quality, topics, findings, recovered, parcel.files)
    raise SandboxCrashedError("answered something else than what was seen")


def _plain(folder: Path, name: str) -> Path:
    """A file of the folder itself, reached by no link."""
    path = folder / name
    if path.resolve() != folder.resolve() / name or not path.is_file():
        raise SandboxCrashedError("recovered no file where it said it did")
    return path
