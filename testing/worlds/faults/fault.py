"""What a fault is: the messages of one role that are altered, the mounts, or the file.

**Conventions.** A role is that of `stone_recordings.topics.roles`, "pose" is whatever the poses come from. An edit gets
a message as rosbags reads it and gives what is recorded in its place: a message, its bytes, several of these, or None.
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
    """Every message."""
    return True


def one(index: int, count: int) -> bool:
    """The one in the middle."""
    return index == count // 2


def tenth(index: int, count: int) -> bool:
    """Every tenth."""
    return index % 10 == 5


def other(index: int, count: int) -> bool:
    """Every other one."""
    return index % 2 == 1


def last_half(index: int, count: int) -> bool:
    """All from the middle on."""
    return index >= count // 2


def middle_third(index: int, count: int) -> bool:
    """A pause, where they are dropped."""
    return count // 3 <= index < 2 * count // 3


def all_but_tenths(index: int, count: int) -> bool:
    """What is dropped where every tenth is left."""
    return index % 10 != 0


def all_but_one(index: int, count: int) -> bool:
    """What is dropped where one is left."""
    return not one(index, count)


@dataclass(frozen=True)
class RecordingFault:
    """`edit` of the messages of `role` that `pick` takes; `misreading` of the calibration; `damage` to the file.

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
    """What is recorded in place of a message, as many as it is."""
    return () if made is None else made if isinstance(made, list) else [made]
