"""`stone score`: a submission against ground truth."""

from pathlib import Path
from typing import Annotated

import typer

from stone_client.options import SubmissionArgument
from stone_client.progress import reported
from stone_client.refusals import refuse_submission
from stone_client.streams import JsonOption, echo_json
from stone_client.tables import confusion_table, score_table, show

GroundTruthOption = Annotated[
    Path,
    typer.Option("--ground-truth", metavar="DIR", exists=True, file_okay=False, help="The folder that holds gts/."),
]


def score(submission: SubmissionArgument, ground_truth: GroundTruthOption, as_json: JsonOption = False) -> None:
    """Score a submission against labels: IoU of occupancy and of each class, over all voxels and within occupied."""
    from services.eval.pipeline import score as score_submission
    from stone_local.frame_order import in_time_order
    from stone_submissions.verdict import SubmissionRefusedError

    with reported() as progress:
        try:
            scores = score_submission(submission, ground_truth, progress=progress, order=in_time_order)
        except SubmissionRefusedError as error:
            refuse_submission(error.validation, as_json=as_json)
    record = scores.as_record()
    if as_json:
        echo_json(record)
        return
    show(score_table(record, f"{record['frames']} frames"))
    show(confusion_table(record["confusion"]))
    typer.echo(f"Signature: {record['signature']}")
