"""`stone validate`: is this submission complete and well-formed?"""

from pathlib import Path
from typing import Annotated

import typer

from client.inputs import SubmissionArgument
from client.refusals import refuse_submission
from client.streams import JsonOption, echo_json

ManifestOption = Annotated[
    Path, typer.Option("--manifest", metavar="M.json", exists=True, dir_okay=False, help="The frames to predict.")
]


def validate(submission: SubmissionArgument, manifest: ManifestOption, as_json: JsonOption = False) -> None:
    """Check a submission against the manifest of its benchmark, without ground truth and without extracting it."""
    from services.eval.pipeline import validate as validate_submission

    validation = validate_submission(submission, manifest)
    if not validation.ok:
        refuse_submission(validation, as_json=as_json)
    if as_json:
        echo_json(validation.as_record())
    else:
        typer.echo("valid")
