"""Output streams of the command: the content and style of stdout and stderr.

**Conventions.** stdout contains the answer (a table, or one JSON object under `--json`); stderr contains progress,
warnings and refusals. Names from recordings and archives are hostile: control characters are printed escaped.
"""

import json
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from typing import Annotated, Any

import typer

from stone_base.codes.catalogue import CATALOGUE, harm_rank
from stone_base.errors import one_line
from stone_base.findings import Finding

WANTS_JSON = "stone.wants_json"
_shows_progress: ContextVar[bool] = ContextVar("shows_progress", default=True)
_shows_notices: ContextVar[bool] = ContextVar("shows_notices", default=True)


def choose_output(*, is_quiet: bool, has_progress: bool) -> None:
    """Set the effect of `--quiet` and `--no-progress` for the current command."""
    _shows_progress.set(has_progress and not is_quiet)
    _shows_notices.set(not is_quiet)


def is_progress_shown() -> bool:
    return _shows_progress.get()


def _remember(context: typer.Context, value: bool) -> bool:
    context.find_root().meta[WANTS_JSON] = value
    return value


JsonOption = Annotated[
    bool, typer.Option("--json", callback=_remember, help="Print one JSON object instead of tables.")
]


def wants_json(context: typer.Context) -> bool:
    """Return whether the command of this context was given `--json`."""
    return bool(context.find_root().meta.get(WANTS_JSON, False))


def echo_json(record: Mapping[str, Any]) -> None:
    """Print one JSON object and a newline. NaN and infinity raise `ValueError`, as JSON lacks them."""
    typer.echo(json.dumps(record, allow_nan=False))


def echo_notice(line: str) -> None:
    """Print one line on stderr about current activity; none under `--quiet`."""
    if _shows_notices.get():
        typer.echo(one_line(line), err=True)


def echo_explainer(findings: Iterable[Finding]) -> None:
    """Print which command explains the codes of the findings, with the most harmful code as its example."""
    known = sorted(
        (item for item in findings if item.code in CATALOGUE), key=lambda item: harm_rank(item.code, item.severity)
    )
    if known:
        echo_notice(f"`stone explain {known[0].code}` explains a code and its remedy")


def echo_findings(findings: Iterable[Finding]) -> None:
    """Print one line per finding on stderr; a finding below an error starts with its severity."""
    for finding in findings:
        grade = "" if finding.severity == "error" else f"{finding.severity}: "
        is_named = not finding.topic or finding.message.startswith(finding.topic)
        about = "" if is_named else f"{finding.topic}: "
        typer.echo(one_line(f"{grade}{finding.code}: {about}{finding.message}"), err=True)
