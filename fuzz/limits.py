"""Limits that every fuzzed input must keep: coded exceptions only, bounded memory.

**Conventions.** A target is a function of bytes that reads them as a hostile file would be read. `StoneError` is the
only exception it may end with. Growth is the kernel's peak of this process above what it held before the input; the
peak is reset before each, or one that cost much would hide all after it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from stone.errors import StoneError

GROWTH_LIMIT_BYTES = 64 * 2**20
STATUS = Path("/proc/self/status")
CLEAR_REFS, RESET_PEAK = Path("/proc/self/clear_refs"), "5"  # man 5 proc

Target = Callable[[bytes], None]


@dataclass(frozen=True)
class FuzzLimits:
    """What an input may take: growth of the process, time, and what the process may hold at all.

    `longest_bytes` is tried from the beginning where it is short. `is_checked` where kernels check their indices
    meanwhile.
    """

    growth_bytes: int
    hang_s: int
    process_mb: int
    longest_bytes: int = 1 << 16
    is_checked: bool = False


OF_PARSERS = FuzzLimits(GROWTH_LIMIT_BYTES, 10, 1024)
# The dense windows of a few frames, beside a point map made for a minute of a full rig.
OF_LABELLING = FuzzLimits(512 * 2**20, 60, 3072, longest_bytes=1 << 8, is_checked=True)


class GrowthError(AssertionError):
    """An input cost more memory than any may."""

    def __init__(self, growth_bytes: int, input_bytes: int, limit_bytes: int) -> None:
        limit = f"the limit is {limit_bytes >> 20} MiB"
        super().__init__(f"{growth_bytes >> 20} MiB for an input of {input_bytes} bytes, {limit}")


class UncodedError(AssertionError):
    """A refusal that no program can tell from another."""

    def __init__(self, error: StoneError) -> None:
        super().__init__(f"{type(error).__name__} has no code, or more than one line: {str(error)[:300]!r}")


@dataclass(frozen=True)
class Memory:
    """What the process holds and the most it held since its peak was reset, bytes."""

    held: int
    peak: int


def memory() -> Memory:
    lines = dict(line.split(":", 1) for line in STATUS.read_text().splitlines())
    return Memory(*(int(lines[name].split()[0]) * 1024 for name in ("VmRSS", "VmHWM")))


def check(target: Target, content: bytes, limits: FuzzLimits = OF_PARSERS) -> None:
    """Raises `GrowthError`, `UncodedError`, and whatever the target lets through."""
    CLEAR_REFS.write_text(RESET_PEAK)
    before = memory()
    try:
        target(content)
    except StoneError as error:
        if type(error) is StoneError or not error.code or "\n" in str(error):
            raise UncodedError(error) from error
    after = memory()
    if after.peak > before.held + limits.growth_bytes:
        raise GrowthError(after.peak - before.held, len(content), limits.growth_bytes)
