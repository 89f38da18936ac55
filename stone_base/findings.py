"""Findings about an input: a code, a grade and a sentence each."""

from dataclasses import asdict, dataclass
from typing import Literal

from stone_base.errors import one_line

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One thing noticed; `topic` is the ROS topic, sensor or file it is about ("" when about the whole)."""

    code: str
    severity: Severity
    topic: str
    message: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "message", one_line(self.message))

    def as_record(self) -> dict[str, str]:
        return asdict(self)
