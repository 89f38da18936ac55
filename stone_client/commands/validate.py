"""`stone validate`: check that a submission is complete and well-formed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from stone_client.choices import refuse_options
from stone_client.options import ServerOption, SubmissionArgument
from stone_client.progress import reported
from stone_client.refusals import refuse_submission
from stone_client.streams import JsonOption, echo_json

ManifestOption = Annotated[
    Path | None,
    typer.Option(
        "--manifest", metavar="M.json", exists=True, dir_okay=False, help="Manifest of the frames to predict."
    ),
]
BenchmarkOption = Annotated[str, typer.Option(metavar="B", help="Benchmark on the server, instead of --manifest.")]
PhaseOption = Annotated[str, typer.Option(metavar="P", help="Phase of the benchmark.")]


def validate(
    submission: SubmissionArgument,
    manifest: ManifestOption = None,
    benchmark: BenchmarkOption = "",
    phase: PhaseOption = "",
    server: ServerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a submission against a manifest with the server's own code, without ground truth or extraction."""
    from stone_submissions.validation import validate as validate_submission

    if (manifest is None) != bool(benchmark and phase) or bool(benchmark) != bool(phase):
        raise typer.BadParameter("either --manifest, or --benchmark and --phase", param_hint="--manifest")
    if manifest is not None:
        refuse_options("it is for --benchmark and --phase; leave it out with --manifest", {"--server": server})
    with _manifest(manifest, (benchmark, phase), server) as path, reported() as progress:
        validation = validate_submission(submission, path, progress=progress)
    if not validation.ok:
        refuse_submission(validation, as_json=as_json)
    if as_json:
        echo_json(validation.as_record())
    else:
        typer.echo("valid")


@contextmanager
def _manifest(given: Path | None, of: tuple[str, str], server: str | None) -> Iterator[Path]:
    """Yield the given manifest, or the current manifest of a phase from the server."""
    if given is not None:
        yield given
        return
    from stone_client.connection import connected
    from stone_client.server.benchmarks import fetch_manifest

    with TemporaryDirectory() as folder, connected(server) as api:
        path = Path(folder) / "manifest.json"
        fetch_manifest(api, of, path)
        yield path
