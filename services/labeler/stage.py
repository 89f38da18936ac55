"""The stages that label a sequence, as values: the work of each kind of job, and the files that it reads.

**Conventions.** `services/labeler/pipeline.py` lists the stages and declares the jobs; `stone label` runs these in
processes (`services/labeler/local_run.py`), the queue as tasks (`services/labeler/queue_handlers.py`). File names are
relative to the run's scratch folder. Stages exchange data only through these files.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from services.labeler.run import LabelRun, Part, Step, Tile

Arguments = Mapping[str, Any]


@dataclass(frozen=True)
class StageResult:
    """`result` is the job's result; `facts` go into its log, if any."""

    result: Mapping[str, int] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Stage:
    """The work of one kind of job, and the files in scratch that it reads.

    - `step_name`: progress name within a job in the queue
    - `shown`: progress name of `stone label` for finished jobs ("" for none)
    - `event`: the log line of a finished job
    - `reads`: name prefixes of files that each job reads, if they exist; `list_near` lists files of one job
    - `requires`: names of files and folders that must exist
    - `reads_sweeps`: whether the job needs the recording; if False, it is not mounted into the sandbox
    """

    work: Callable[[LabelRun, Arguments, Step], StageResult]
    step_name: str
    list_near: Callable[[LabelRun, Arguments], tuple[str, ...]] | None = None
    reads: tuple[str, ...] = ()
    requires: tuple[str, ...] = ()
    shown: str = ""
    event: str = ""
    reads_sweeps: bool = False


def part_of(arguments: Arguments) -> Part:
    """Return the part of a job."""
    begin, end = arguments["part"]
    return begin, end


def tile_of(arguments: Arguments) -> Tile:
    """Return the tile of a job."""
    return Tile(*arguments["tile"])
