"""A fault: the altered messages of one role, the mounts, or the file.

**Conventions.** A role is that of `stone_recordings.topics.roles`, "pose" is the role of the pose source. An edit
receives a message as rosbags reads it and returns its replacement: a message, its bytes, several of these, or None.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stone.sensors.calibration import Calibration

Edit = Callable[[Any], Any]
Damage = Callable[[Path], None]
Misreading = Callable[[Calibration], Calibration]
Pick = Callable[[int, int], bool]


def every(index: int, count: int) -> bool:
    """Pick every message."""
    return True


def one(index: int, count: int) -> bool:
    """Pick the message in the middle."""
    return index == count // 2


def tenth(index: int, count: int) -> bool:
    """Pick every tenth message."""
    return index % 10 == 5


def other(index: int, count: int) -> bool:
    """Pick every other message."""
    return index % 2 == 1


def last_half(index: int, count: int) -> bool:
    """Pick all messages from the middle on."""
    return index >= count // 2


def middle_third(index: int, count: int) -> bool:
    """Pick the middle third: a pause, if dropped."""
    return count // 3 <= index < 2 * count // 3


def all_but_tenths(index: int, count: int) -> bool:
    """Pick all but every tenth message."""
    return index % 10 != 0


def all_but_one(index: int, count: int) -> bool:
    """Pick all but one message."""
    return not one(index, count)


@dataclass(frozen=True)
class RecordingFault:
    """`edit` for the messages of `role` that `pick` selects; `misreading` of the calibration; `damage` to the file.

    `needs_type` is a type that the topic must have for the fault to exist. `is_compressed`: written in zstd chunks.
    """

    name: str
    role: str = ""
    edit: Edit | None = None
    pick: Pick = every
    misreading: Misreading | None = None
    damage: Damage | None = None
    needs_type: str = ""
    is_compressed: bool = False


def listed(made: Any) -> Sequence[Any]:
    """Return the messages recorded in place of one message."""
    return () if made is None else made if isinstance(made, list) else [made]
