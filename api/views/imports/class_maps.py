"""Class maps that come as text: read in a sandboxed child within limits, as whatever strangers bring.

**Conventions.** Of 64 KiB of YAML, a child that is given 10 s and 512 MiB is all that can be used up; no more than
`AT_ONCE` are read at a time and the others wait, briefly; then they are told to come back.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import BoundedSemaphore
from typing import Annotated, ClassVar

from pydantic import Field

from api.errors import rate_limited
from api.sandboxed_reading import class_map_read
from services.domain.imports.requests import Meaning, StatedClasses
from services.runtime.sandbox import SandboxLimits, sandboxed
from services.runtime.sandbox.answers import SandboxAnswer

LIMITS = SandboxLimits(memory_bytes=512 * 2**20, cpu_s=10, wall_s=30.0)
AT_ONCE, PATIENCE_S, PER_MINUTE = 2, 10.0, 60.0
FILE = "classes.yaml"

_turns = BoundedSemaphore(AT_ONCE)


class ClassMapAnswer(SandboxAnswer):
    """What the child read: the map's name, and what each number means."""

    expected: ClassVar[str] = "a class map"
    name: Annotated[str, Field(max_length=100)]
    meanings: dict[Annotated[int, Field(ge=0, le=255)], Meaning]


def stated_classes(text: str) -> StatedClasses:
    """The map in the text. Raises `DST-070`; `rate_limited` when too many are being read."""
    if not _turns.acquire(timeout=PATIENCE_S):
        raise rate_limited(PER_MINUTE, int(PATIENCE_S))
    try:
        with TemporaryDirectory(prefix="stone-classes-") as folder:
            path = Path(folder) / FILE
            path.write_text(text, "utf-8")
            answer = ClassMapAnswer.believed(sandboxed(partial(class_map_read, path), replace(LIMITS, reads=(path,))))
    finally:
        _turns.release()
    return StatedClasses(answer.name, answer.meanings)
