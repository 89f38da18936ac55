"""Files of a recording that were cut off: what is whole in each is written anew, the original stays as it is.

**Conventions.** A recovery has the same bytes whenever it is made of the same file (`services/ingest/recovery.py`), so
an attempt that is repeated makes the same one.
"""

from dataclasses import dataclass
from pathlib import Path

from services.ingest.bag import open_bag
from services.ingest.errors import CutBagError, IngestError
from services.ingest.named import named
from services.ingest.received import Received, ReceivedFile
from services.ingest.recovery import recover
from services.runtime.errors import PlatformFaultError
from stone.findings import Finding


@dataclass(frozen=True)
class RecoveredFile:
    """An MCAP file that is read in the place of the one that was cut off, and what is said of that."""

    path: Path
    finding: Finding


def recovered_files(received: Received, folder: Path) -> dict[str, RecoveredFile]:
    """By the `row_id` of each file that was cut off; written into `folder`.

    Raises the refusal of a file of which nothing could be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cut = [file for file in received.files if _is_cut(received, file)]
    return {file.row_id: _recovered(received.folder, file, folder) for file in cut}


def _is_cut(received: Received, file: ReceivedFile) -> bool:
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
