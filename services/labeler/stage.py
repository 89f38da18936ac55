"""The stages that label a sequence, as values: what the jobs of a kind do, and which files they read.

**Conventions.** `services/labeler/pipeline.py` names them and declares the jobs; `stone label` runs these in processes
(`services/labeler/local_run.py`), the queue as tasks (`services/labeler/queue_handlers.py`). Files are named relative
to the scratch folder of the run, and are all that one stage leaves for another.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from services.labeler.run import LabelRun, Part, Step, Tile

Arguments = Mapping[str, Any]


@dataclass(frozen=True)
class StageResult:
    """`result` is what the job answers; `facts` go into its log, when there are any."""

    result: Mapping[str, int] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Stage:
    """What the jobs of one kind do, and the files in scratch that they read.

    `step_name` is how the queue tells the progress within a job, `shown` how `stone label` tells how many jobs are
    done ("" where it tells nothing), `event` the log line of a job that is done. `reads` are beginnings of names that
    each job reads, `list_near` lists those of one job; there may be no such file. `requires` names files and folders
    that must be there. A stage without `reads_sweeps` is not given the recording.
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
    """The part that a job is about."""
    begin, end = arguments["part"]
    return begin, end


def tile_of(arguments: Arguments) -> Tile:
    """The tile that a job is about."""
    return Tile(*arguments["tile"])
