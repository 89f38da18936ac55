"""Findings about an input: each has a code, a severity and a sentence."""

from dataclasses import asdict, dataclass
from typing import Literal

from stone_base.errors import one_line

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One observation about `topic`: a ROS topic, sensor or file, or "" for the whole input."""

    code: str
    severity: Severity
    topic: str
    message: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "message", one_line(self.message))

    def as_record(self) -> dict[str, str]:
        return asdict(self)
