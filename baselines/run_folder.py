"""The folder of a run, which records its row once, so that a resumed run trains the same row."""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from torch.utils.tensorboard.writer import SummaryWriter

from baselines.checkpoint import CHECKPOINT
from baselines.row_config import RowConfig, row_of
from stone.errors import Refused
from stone_files.atomic import atomic_file

ROW_FILE = "row.json"


def opened_run(folder: Path, row: RowConfig, resume: bool) -> tuple[RowConfig, bool]:
    """Return the run's row, and whether it can continue from a checkpoint; nothing is written.

    A run killed before its first checkpoint starts again. Raises `run_exists` if a run exists and `resume` is false,
    `bad_run` if it trains another row.
    """
    named = folder / ROW_FILE
    if not named.exists():
        if resume:
            raise Refused(
                "bad_run", f"{folder}: there is no {ROW_FILE}, so there is no run to resume; leave out --resume"
            )
        return row, False
    if not resume:
        raise Refused("run_exists", f"{folder} contains a run: continue it with --resume, or give another folder")
    begun = read_run_row(folder)
    if begun.as_json() != row.as_json():
        raise Refused(
            "bad_run", f"{folder}: it trains {differences(begun, row)}; resume it with the same row and options"
        )
    return begun, (folder / CHECKPOINT).exists()


def write_run_row(folder: Path, row: RowConfig) -> None:
    """Create the folder as a run of this row."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_file(folder / ROW_FILE) as staging:
        staging.write_text(row.as_json() + "\n", "utf-8")


def read_run_row(folder: Path) -> RowConfig:
    """Return the row of a run. Raises `bad_run`, `bad_row`."""
    try:
        record = json.loads((folder / ROW_FILE).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise Refused(
            "bad_run", f"{folder}: it is not a run of `stone model train`: {ROW_FILE} cannot be read"
        ) from error
    return row_of(str(folder), record)


def differences(row: RowConfig, other: RowConfig) -> str:
    """Return the differences of two rows in words."""
    a, b = _flat(json.loads(row.as_json())), _flat(json.loads(other.as_json()))
    parts = [f"{key} {a.get(key)}, not {b.get(key)}" for key in sorted(a.keys() | b.keys()) if a.get(key) != b.get(key)]
    return "; ".join(parts[:3])


def _flat(value: object, path: str = "") -> dict[str, object]:
    if not isinstance(value, dict):
        return {path: value}
    leaves = dict[str, object]()
    for key, part in value.items():
        leaves |= _flat(part, f"{path}.{key}" if path else str(key))
    return leaves


# The log of a run: a JSON line per report, and the same for TensorBoard. A resumed run deletes its log after its
# checkpoint, so that no step is logged twice.


LOG, TENSORBOARD = "log.jsonl", "tensorboard"


@dataclass(frozen=True)
class TrainingReport:
    """The progress of a run: `losses` by term, `scores` of the platform's metric, `watched` on validation sequences."""

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
    """A writer of one run's reports; used as a context manager."""

    def __init__(self, folder: Path, step: int) -> None:
        self._path = folder / LOG
        kept = [line for record, line in self._lines() if record["step"] <= step]
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
        """Yield whole lines of an earlier part of the run; a kill may have cut the last one."""
        if self._path.exists():
            for line in self._path.read_text("utf-8").splitlines():
                with suppress(ValueError):
                    yield json.loads(line), line

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._board.close()
