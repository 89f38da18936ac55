"""Class maps that come as text: read in a sandboxed child within limits, like all files of users.

**Conventions.** The child has 10 s and 512 MiB for 64 KiB of YAML. At most `AT_ONCE` texts are read at a time; others
wait briefly and are then refused with `rate_limited`.
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
    """The child's result: the map's name, and the meaning of each number."""

    expected: ClassVar[str] = "a class map"
    name: Annotated[str, Field(max_length=100)]
    meanings: dict[Annotated[int, Field(ge=0, le=255)], Meaning]


def stated_classes(text: str) -> StatedClasses:
    """Return the map in the text. Raises `DST-070`; `rate_limited` if too many are being read."""
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
