"""Recovery of truncated recording files: what is whole is written to a new file, the original stays as it is.

**Conventions.** A recovery has the same bytes whenever it is made of the same file
(`stone_recordings/bags/recovery/recovery.py`), so an attempt that is repeated makes the same one.
"""

from dataclasses import dataclass
from pathlib import Path

from services.ingest.received_files import ReceivedBag, ReceivedFile
from services.runtime.store.named_objects import named
from stone.errors import PlatformFaultError
from stone.findings import Finding
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import CutBagError, IngestError
from stone_recordings.bags.recovery.recovery import recover


@dataclass(frozen=True)
class RecoveredFile:
    """An MCAP file that is read in the place of the one that was cut off, and what is said of that."""

    path: Path
    finding: Finding


def recovered_files(received: ReceivedBag, folder: Path) -> dict[str, RecoveredFile]:
    """By the `row_id` of each file that was cut off; written into `folder`.

    Raises the refusal of a file of which nothing could be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cut = [file for file in received.files if _is_cut(received, file)]
    return {file.row_id: _recovered(received.folder, file, folder) for file in cut}


def _is_cut(received: ReceivedBag, file: ReceivedFile) -> bool:
    try:
        open_bag(named(received.folder, file.path, file.filename)).close()
    except CutBagError:
        return True
    except PlatformFaultError:
        raise
    except IngestError:  # alone it may be no bag: a metadata.yaml, a database without its log
        return False
    return False


def _recovered(names: Path, file: ReceivedFile, folder: Path) -> RecoveredFile:
    path, out = named(names, file.path, file.filename), folder / f"{file.row_id}.mcap"
    recovery = recover(path, out)
    if recovery.messages == 0:
        raise CutBagError(file.filename, recovery.read_bytes)
    return RecoveredFile(out, recovery.finding)
