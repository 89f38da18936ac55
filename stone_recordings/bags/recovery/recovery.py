"""A recording that cannot be opened, or has no index, written anew: chunked, indexed, with everything that is whole.

**Conventions.** The original is only read. The copy is written beside its target and renamed when it is complete, so a
recovery that is killed leaves nothing under the target's name. Messages keep their log and publish time, sequence and
bytes, channels their metadata; ids may change. Memory is one chunk of either file.
"""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from stone.findings import Finding, Severity
from stone_files.atomic import atomic_file
from stone_recordings.bags.errors import RecoveryTargetError
from stone_recordings.bags.mcap.copy import Copy, opened_copy
from stone_recordings.bags.members import members_of
from stone_recordings.bags.recovery.sources import RecoverySource, opened_source


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
    """Write `out`, an MCAP file, from whatever is whole of `path`: a file, or all the files of a folder.

    One file gives the same bytes whenever it is recovered.
    Raises: FileNotFoundError, NotABagError (BAG-001), CutBagError (not even the magic is whole), RecoveryTargetError
    (BAG-026: `out` is part of the original), DatabaseRefusedError, MembersRefusedError, OSError.
    """
    members = members_of(path)
    if out.exists() and any(out.samefile(file) for file in members.files):
        raise RecoveryTargetError(out.name)
    with ExitStack() as opened:
        sources = [opened.enter_context(opened_source(file)) for file in members.files]
        staging = opened.enter_context(atomic_file(out))
        with staging.open("wb") as stream, opened_copy(stream, sources[0].compression) as copy:
            for source in sources:
                source.keep(copy)
    return _in_words(path.name, sources, members.findings, copy)


def _in_words(name: str, sources: list[RecoverySource], noticed: tuple[Finding, ...], copy: Copy) -> Recovery:
    read_bytes, total_bytes = (sum(n) for n in zip(*((s.read_bytes, s.total_bytes) for s in sources), strict=True))
    is_sealed = all(source.losses.is_sealed for source in sources)
    is_broken = any(source.losses.problems for source in sources)
    is_whole = is_sealed and not noticed and not is_broken
    lost = _lost(sources, noticed, copy)
    told = [source.losses.told_messages for source in sources]
    of_all = "" if None in told else f" of {sum(count or 0 for count in told)}"
    counted = f"{copy.messages}{of_all} messages of {len(copy.topics)} topics"
    kept = f"{counted}, the last logged at {copy.last_ns} ns, are recovered"
    whole = "is damaged" if is_broken else "is complete up to its index"
    ended = whole if is_sealed else f"was cut off at byte {read_bytes} of {total_bytes}"
    severity: Severity = "info" if is_whole else "warning"
    finding = Finding("BAG-010", severity, "", f"{name} {ended}: {kept}. {lost}")
    return Recovery(copy.messages, copy.topics, read_bytes, total_bytes, copy.last_ns, lost, finding)


def _lost(sources: list[RecoverySource], noticed: tuple[Finding, ...], copy: Copy) -> str:
    """One sentence; how long a cut took away is an estimate from the mean rate of what was kept."""
    kept_bytes = sum(source.read_bytes for source in sources)
    rate_s = (copy.last_ns - copy.first_ns) / 1e9 / max(1, kept_bytes)
    parts = [finding.message.removesuffix(".") for finding in noticed if finding.severity == "error"]
    for source in sources:
        about = f"{source.name}: " if len(sources) > 1 else ""
        parts += [f"{about}{part}" for part in _lost_of(source, rate_s)]
    return f"Lost: {'; '.join(parts)}." if parts else "Nothing is lost but the index."


def _lost_of(source: RecoverySource, rate_s: float) -> Iterator[str]:
    left_bytes = source.total_bytes - source.read_bytes
    if left_bytes:
        yield f"the incomplete part of the last {left_bytes} bytes (about {left_bytes * rate_s:.3f} s)"
    if not source.losses.is_sealed:
        yield "whatever the recorder had not written yet"
    yield from source.losses.problems
    if source.losses.unsaid:
        yield f"{source.losses.unsaid} more pieces"
