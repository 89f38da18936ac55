"""Uploaded calibration files: read in a sandboxed child process within limits, refused with coded findings.

**Conventions.** Reading a hostile megabyte costs up to three seconds of one core. At most `AT_ONCE` files are read at a
time; others wait briefly and are then refused with `rate_limited`. The parsers run in a child without network, files to
write or the API's connections (`services/runtime/sandbox`), and return one JSON object.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import BoundedSemaphore
from typing import IO

from api.errors import CalibrationRefusedError, body_too_large, rate_limited
from api.files import safe_name
from api.sandboxed_reading import calibration_read
from api.schemas.base import EPOCH
from services.domain.sequences.calibrations import ReadCalibration, Validity
from services.runtime.sandbox import SandboxCrashedError, SandboxLimits, sandboxed
from services.runtime.sandbox.result_files import unpacked
from services.runtime.store.protocol import Store
from stone.errors import PlatformFaultError, Refused, StoneError
from stone.findings import Finding
from stone.sensors.calibration import Calibration
from stone_recordings.calibrations.errors import bad_calibration_key
from stone_recordings.calibrations.file import CalibrationRead
from stone_recordings.calibrations.record import calibration_of

LARGEST_BYTES = 2**20
AT_ONCE = 2
PATIENCE_S = 10.0
PER_MINUTE = 60.0
LIMITS = SandboxLimits(memory_bytes=512 * 2**20, cpu_s=10, wall_s=30.0)
FORM = "the form"

_turns = BoundedSemaphore(AT_ONCE)


@contextmanager
def receive(file: IO[bytes], filename: str) -> Iterator[Path]:
    """Yield the path of the file under its own name in a temporary folder. Raises `body_too_large`."""
    content = file.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise body_too_large(LARGEST_BYTES)
    with TemporaryDirectory(prefix="stone-calibration-") as folder:
        path = Path(folder) / safe_name(filename)
        path.write_bytes(content)
        yield path


def read(path: Path) -> ReadCalibration:
    """Return the calibration in the file; raises as `read_sandboxed`."""
    reading = read_sandboxed(path)
    mounts = reading.calibration.mounts
    sensors = tuple({"name": mount.name, "kind": mount.kind, "frame_id": mount.frame_id} for mount in mounts)
    findings = tuple(finding.as_record() for finding in reading.findings)
    return ReadCalibration(reading.calibration.name, path.name, sensors, findings, reading.format)


def read_sandboxed(path: Path) -> CalibrationRead:
    """Return the calibration in a file or a zip.

    Raises `CalibrationRefusedError`; `rate_limited` if too many are being read; `ConfinedInterruptedError`.
    """
    if not _turns.acquire(timeout=PATIENCE_S):
        raise rate_limited(PER_MINUTE, int(PATIENCE_S))
    try:
        reading = _unpack(path.name, sandboxed(partial(calibration_read, path), replace(LIMITS, reads=(path,))))
        _check_names(path.name, reading.calibration)
    except PlatformFaultError:
        raise
    except StoneError as reason:
        raise CalibrationRefusedError(path.name, reason) from reason
    finally:
        _turns.release()
    return reading


def _unpack(name: str, answer: bytes) -> CalibrationRead:
    record = unpacked(answer).record
    try:
        findings = tuple(Finding(**finding) for finding in record["findings"])
        return CalibrationRead(calibration_of(record["calibration"]), findings, record["format"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SandboxCrashedError(f"returned something other than the calibration {name}") from error


def read_stored(store: Store, object_key: str, filename: str) -> Calibration:
    """Return a stored calibration, read again; raises as `read_sandboxed`, and ObjectMissingError."""
    content = b"".join(store.read(object_key))
    with receive(BytesIO(content), filename) as path:
        return read_sandboxed(path).calibration


def validity(valid_from: datetime | None, valid_to: datetime | None) -> Validity:
    """Return the validity. Raises `CalibrationRefusedError` if it is empty or outside the range of nanoseconds since
    1970.
    """
    interval = Validity(*(None if moment is None else _since_1970_ns(moment) for moment in (valid_from, valid_to)))
    reached = [moment_ns for moment_ns in (interval.from_ns, interval.to_ns) if moment_ns is not None]
    if any(not 0 <= moment_ns < 2**63 for moment_ns in reached):
        raise CalibrationRefusedError(FORM, validity_refusal(FORM, "its years are not between 1970 and 2262"))
    if len(reached) == len((valid_from, valid_to)) and reached[0] >= reached[1]:
        raise CalibrationRefusedError(FORM, validity_refusal(FORM, "valid_from is not before valid_to"))
    return interval


def _since_1970_ns(moment: datetime) -> int:
    return (moment - EPOCH) // timedelta(microseconds=1) * 1000


def _check_names(filename: str, calibration: Calibration) -> None:
    """Check that names are printable, because people read and search them. Raises `CAL-422`."""
    for name in (calibration.name, *(mount.name for mount in calibration.mounts)):
        if not name.isprintable():
            raise bad_calibration_key(filename, repr(name)[:80], "a name of printable characters", 0)


def validity_refusal(name: str, problem: str) -> Refused:
    return Refused("CAL-418", f"{name}: {problem}; give `valid_from` before `valid_to`, or leave one out")
