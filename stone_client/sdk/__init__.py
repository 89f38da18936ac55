"""The platform from Python: the `stone` command's functions, with return values.

    from stone_client import Stone

    with Stone() as stone:
        stone.upload("run.mcap", calibration="robot.yaml", name="forest").process().wait()
        semantics = stone.labels("forest")["semantics"]

**Conventions.** Names are those of the command. Lists are a `Table` of frozen dataclasses, with `to_pandas()`. A
refusal raises a `StoneError`, whose `code` programs read. Every call may be repeated: existing results are reused.
"""

from stone_base.errors import StoneError
from stone_client.errors import JobFailedError, ServerRefusedError, ServerUnreachableError
from stone_client.sdk.datasets import DatasetVersion
from stone_client.sdk.labels import Labels
from stone_client.sdk.records import (
    Benchmark,
    BoardRow,
    Comparison,
    LabelSet,
    Leaderboard,
    Part,
    Phase,
    RatioDifference,
    Results,
    Upload,
)
from stone_client.sdk.runs import Run
from stone_client.sdk.sequences import Export, Sequence
from stone_client.sdk.stone import Stone, ignore_progress
from stone_client.sdk.submissions import Submission
from stone_client.sdk.tables import Table
from stone_client.server.submission import SubmissionEndedError, SubmissionInvalidError

__all__ = [
    "Benchmark",
    "BoardRow",
    "Comparison",
    "DatasetVersion",
    "Export",
    "JobFailedError",
    "LabelSet",
    "Labels",
    "Leaderboard",
    "Part",
    "Phase",
    "RatioDifference",
    "Results",
    "Run",
    "Sequence",
    "ServerRefusedError",
    "ServerUnreachableError",
    "Stone",
    "StoneError",
    "Submission",
    "SubmissionEndedError",
    "SubmissionInvalidError",
    "Table",
    "Upload",
    "ignore_progress",
]
