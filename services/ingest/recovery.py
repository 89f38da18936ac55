"""A recording that cannot be opened, or has no index, written anew: chunked, indexed, with everything that is whole.

**Conventions.** The original is only read. The copy is written beside its target and renamed when it is complete, so a
recovery that is killed leaves nothing under the target's name. Messages keep their log and publish time, sequence and
bytes, channels their metadata; ids may change. Memory is one chunk of either file.
"""

import mmap
from dataclasses import asdict, dataclass
from pathlib import Path

from services.ingest import mcap_records as wire
from services.ingest.errors import RecoveryTargetError
from services.ingest.magic import container_of
from services.ingest.mcap_copy import Copy, opened_copy
from services.ingest.mcap_salvage import Losses, complete_records, first_compression
from services.runtime.atomic import atomic_file
from stone.findings import Finding, Severity

FORGET_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Recovery:
    """What was kept and what was not.

    `topics` counts by name; `read_bytes` of the original's `total_bytes` hold complete records; `last_ns` is the latest
    log time kept, 0 without messages; `lost` says in a sentence what is missing.
    """

    messages: int
    topics: dict[str, int]
    read_bytes: int
    total_bytes: int
    last_ns: int
    lost: str
    finding: Finding

    def as_record(self) -> dict[str, object]:
        return {**asdict(self), "finding": self.finding.as_record()}


def recover(path: Path, out: Path) -> Recovery:
    """Write `out`, an MCAP file, from whatever of `path` is complete.

    Raises: FileNotFoundError, NotABagError (BAG-001), RecoveryTargetError (BAG-026: `out` is the original), OSError.
    """
    if out.exists() and out.samefile(path):
        raise RecoveryTargetError(path.name)
    container_of(path)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        losses = Losses()
        with atomic_file(out) as staging, memoryview(mapped) as view:
            compression = first_compression(view, path.name)
            with staging.open("wb") as stream, opened_copy(stream, compression, losses) as copy:
                _keep_all(mapped, view, path.name, copy)
        return _told(path.name, len(mapped), copy, losses)


def _keep_all(mapped: mmap.mmap, view: memoryview, name: str, copy: Copy) -> None:
    forgotten = 0
    for found in complete_records(view, name, copy.losses):
        copy.keep(found)
        if copy.losses.stop_byte - forgotten > FORGET_BYTES:
            mapped.madvise(mmap.MADV_DONTNEED, 0, copy.losses.stop_byte // mmap.PAGESIZE * mmap.PAGESIZE)
            forgotten = copy.losses.stop_byte
    copy.say_unknown()


def _told(name: str, total_bytes: int, copy: Copy, losses: Losses) -> Recovery:
    read_bytes = total_bytes if losses.is_sealed else losses.stop_byte
    lost = _lost(total_bytes, copy, losses)
    kept = f"{copy.messages} messages of {len(copy.topics)} topics, the last logged at {copy.last_ns} ns, are recovered"
    ended = "is complete up to its index" if losses.is_sealed else f"was cut off at byte {read_bytes} of {total_bytes}"
    severity: Severity = "info" if losses.is_sealed and not losses.problems else "warning"
    finding = Finding("BAG-010", severity, "", f"{name} {ended}: {kept}. {lost}")
    return Recovery(copy.messages, copy.topics, read_bytes, total_bytes, copy.last_ns, lost, finding)


def _lost(total_bytes: int, copy: Copy, losses: Losses) -> str:
    """One sentence; how long the cut took away is an estimate from the mean rate of what was kept."""
    parts = []
    left_bytes = 0 if losses.is_sealed else total_bytes - losses.stop_byte
    if left_bytes:
        span_s = (copy.last_ns - copy.first_ns) / 1e9
        about_s = span_s * left_bytes / max(1, losses.stop_byte - len(wire.MAGIC))
        parts.append(f"of the last {left_bytes} bytes (about {about_s:.3f} s) what was not whole")
    if not losses.is_sealed:
        parts.append("whatever the recorder had not written yet")
    parts += losses.problems
    if losses.unsaid:
        parts.append(f"{losses.unsaid} more pieces")
    return f"Lost: {'; '.join(parts)}." if parts else "Nothing is lost but the index."
