"""Limits that every fuzzed input must keep: coded exceptions only, bounded memory.

**Conventions.** A target is a function of bytes that reads them as a hostile file. Its only permitted exception is
`StoneError`. Growth is the kernel's peak of this process above its memory before the input. The peak is reset before
each input, or one costly input would hide later ones.
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
    """Limits of an input: growth of the process, time, and total memory of the process.

    Inputs have at most `longest_bytes`, and this length from the start if it is short. `is_checked`: kernels check
    their indices.
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
    """An input cost more memory than the limit."""

    def __init__(self, growth_bytes: int, input_bytes: int, limit_bytes: int) -> None:
        limit = f"the limit is {limit_bytes >> 20} MiB"
        super().__init__(f"{growth_bytes >> 20} MiB for an input of {input_bytes} bytes, {limit}")


class UncodedError(AssertionError):
    """A refusal without a code."""

    def __init__(self, error: StoneError) -> None:
        super().__init__(f"{type(error).__name__} has no code, or more than one line: {str(error)[:300]!r}")


@dataclass(frozen=True)
class Memory:
    """The current and the peak memory of the process, bytes."""

    held: int
    peak: int


def memory() -> Memory:
    lines = dict(line.split(":", 1) for line in STATUS.read_text().splitlines())
    return Memory(*(int(lines[name].split()[0]) * 1024 for name in ("VmRSS", "VmHWM")))


def check(target: Target, content: bytes, limits: FuzzLimits = OF_PARSERS) -> None:
    """Run a target. Raises `GrowthError`, `UncodedError`, and other exceptions of the target."""
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
