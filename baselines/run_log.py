"""The log of a run: a JSON line a report, and the same for TensorBoard.

**Conventions.** A run that goes on forgets what it said after its checkpoint, so that no step is logged twice.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from torch.utils.tensorboard.writer import SummaryWriter

from stone_files.atomic import atomic_file

LOG, TENSORBOARD = "log.jsonl", "tensorboard"


@dataclass(frozen=True)
class TrainingReport:
    """Where a run is. `losses` by term, `scores` of the platform's metric; `watched`: of sequences not trained on."""

    step: int
    steps: int
    epoch: int
    losses: Mapping[str, float] = field(default_factory=dict)
    scores: Mapping[str, float | None] = field(default_factory=dict)
    learning_rate: float = 0.0
    frames_per_s: float = 0.0
    left_s: float = 0.0
    watched: bool = False

    @property
    def loss(self) -> float:
        return sum(self.losses.values())


class RunLog:
    """Writes reports of one run; used as a context manager."""

    def __init__(self, folder: Path, step: int) -> None:
        self._path = folder / LOG
        kept = [line for said, line in self._lines() if said["step"] <= step]
        with atomic_file(self._path) as staging:
            staging.write_text("".join(f"{line}\n" for line in kept), "utf-8")
        self._file = self._path.open("a", encoding="utf-8")
        self._board = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def write(self, report: TrainingReport) -> None:
        self._file.write(json.dumps(asdict(report), sort_keys=True) + "\n")
        self._file.flush()
        part = "watched" if report.watched else "training"
        for name, value in {**report.losses, **report.scores}.items():
            if value is not None:
                self._board.add_scalar(f"{part}/{name}", value, report.step)

    def _lines(self) -> Iterator[tuple[Mapping[str, Any], str]]:
        """Whole lines of an earlier part of the run; a kill may have cut the last one."""
        if self._path.exists():
            for line in self._path.read_text("utf-8").splitlines():
                with suppress(ValueError):
                    yield json.loads(line), line

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._board.close()
