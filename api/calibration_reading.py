"""A calibration file from outside: bounded, read by a few threads at most, refused with coded findings.

**Conventions.** Reading a hostile megabyte costs up to three seconds of one core, so no more than `AT_ONCE` are read at
a time and the others wait, briefly; then they are told to come back.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import BoundedSemaphore
from typing import IO

from api.errors import BodyTooLargeError, RateLimitedError
from api.file_errors import CalibrationRefusedError
from api.files import safe_name
from services.ingest.calibration_errors import CalibrationKeyError
from services.ingest.calibration_file import read_calibration
from services.runtime.calibrations import ReadCalibration
from stone.calibration import Calibration
from stone.errors import StoneError

LARGEST_BYTES = 2**20
AT_ONCE = 2
PATIENCE_S = 10.0
PER_MINUTE = 60.0

_turns = BoundedSemaphore(AT_ONCE)


@contextmanager
def received(file: IO[bytes], filename: str) -> Iterator[Path]:
    """The file under its own name in a folder that lasts as long as this. Raises `BodyTooLargeError`."""
    content = file.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise BodyTooLargeError(LARGEST_BYTES)
    with TemporaryDirectory(prefix="stone-calibration-") as folder:
        path = Path(folder) / safe_name(filename)
        path.write_bytes(content)
        yield path


def read(path: Path) -> ReadCalibration:
    """What the file amounts to.

    Raises `CalibrationRefusedError`; `RateLimitedError` when too many are being read.
    """
    if not _turns.acquire(timeout=PATIENCE_S):
        raise RateLimitedError(PER_MINUTE, int(PATIENCE_S))
    try:
        calibration, findings = read_calibration(path)
        _check_names(path.name, calibration)
    except StoneError as reason:
        raise CalibrationRefusedError(path.name, reason) from reason
    finally:
        _turns.release()
    sensors = tuple({"name": mount.name, "kind": mount.kind} for mount in calibration.mounts)
    return ReadCalibration(calibration.name, path.name, sensors, tuple(finding.as_record() for finding in findings))


def _check_names(filename: str, calibration: Calibration) -> None:
    """Names are shown and looked for. Raises `CalibrationKeyError` for one with characters nobody can see."""
    for name in (calibration.name, *(mount.name for mount in calibration.mounts)):
        if not name.isprintable():
            raise CalibrationKeyError(filename, repr(name)[:80], "a name has printable characters only", 0)
