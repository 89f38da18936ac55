"""The check that a recording was made while its calibration was valid.

**Conventions.** The valid time is [from, to), nanoseconds since 1970; None leaves a side open.
"""

from datetime import UTC, datetime

from stone.findings import Finding
from stone.sensors.sequence import Sequence


def validity_findings(sequence: Sequence, valid_from_ns: int | None, valid_to_ns: int | None) -> tuple[Finding, ...]:
    """Return CAL-418 if a frame lies outside the calibration's valid time; () for a sequence without frames."""
    stamps_ns = sequence.frames.stamps_ns
    if not len(stamps_ns):
        return ()
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    is_early = valid_from_ns is not None and first_ns < valid_from_ns
    is_late = valid_to_ns is not None and last_ns >= valid_to_ns
    if not (is_early or is_late):
        return ()
    sentence = (
        f"recorded from {_shown(first_ns)} to {_shown(last_ns)}, but the calibration {sequence.calibration.name!r} is "
        f"valid from {_shown(valid_from_ns)} to {_shown(valid_to_ns)}. The calibration is used; check whether another "
        "version fits"
    )
    return (Finding("CAL-418", "warning", "", sentence),)


def _shown(moment_ns: int | None) -> str:
    return "ever" if moment_ns is None else f"{datetime.fromtimestamp(moment_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S}Z"
