"""`stone score`: a submission against ground truth."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from stone_base.newer_python import StrEnum
from stone_client.options import GridOption, SubmissionArgument
from stone_client.platform_part import is_platform_installed, platform_module
from stone_client.progress import reported
from stone_client.refusals import refuse_submission
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import DASH, confusion_table, score_table, show

GroundTruthOption = Annotated[
    Path,
    typer.Option("--ground-truth", metavar="DIR", exists=True, file_okay=False, help="Folder that contains gts/."),
]

LeastConfidenceOption = Annotated[
    float,
    typer.Option(
        "--least-confidence",
        min=0.0,
        max=1.0,
        help="Leave out occupied ground truth whose label has a lower confidence (default: none). "
        "Requires labels from `stone label --confidence`.",
        show_default=False,
    ),
]


class Mask(StrEnum):
    """Which voxels are scored."""

    ALL = "all"
    LIDAR = "lidar"
    CAMERA = "camera"


MaskOption = Annotated[
    Mask,
    typer.Option("--mask", help="Voxels to score: all, observed by the LiDAR, or observed by the LiDAR and a camera."),
]


def score(
    submission: SubmissionArgument,
    ground_truth: GroundTruthOption,
    least_confidence: LeastConfidenceOption = 0.0,
    grid: GridOption = None,
    mask: MaskOption = Mask.ALL,
    as_json: JsonOption = False,
) -> None:
    """Score a submission against labels: IoU of occupancy and of each class, over all voxels and within occupied."""
    from stone_files.grid_file import chosen_grid
    from stone_submissions.verdict import SubmissionRefusedError

    scoring = platform_module("scoring", "score") if is_platform_installed() else import_module("stone_client.scoring")
    with reported() as progress:
        try:
            scores = scoring.score(
                submission,
                ground_truth,
                mask=mask.value,
                least_confidence=least_confidence,
                progress=progress,
                grid=chosen_grid(grid) if grid else None,
            )
        except SubmissionRefusedError as error:
            refuse_submission(error.validation, as_json=as_json)
    record = scores.as_record()
    if as_json:
        echo_json(record)
        return
    show(score_table(record, f"{record['frames']} frames{_left_out(record)}"))
    show(confusion_table(record["confusion"]))
    typer.echo(f"Signature: {record['signature']}")


def _left_out(record: Mapping[str, Any]) -> str:
    if "confidence" not in record:
        return ""
    limit = record["confidence"]
    share = DASH if limit["left_out_ratio"] is None else f"{100 * limit['left_out_ratio']:.1f} %"
    return f"; {share} of occupied voxels left out (confidence below {limit['least_confidence']:g})"
