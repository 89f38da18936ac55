"""Exit codes and messages of the command for refused inputs.

**Conventions.** A refusal is one line `code: sentence` on stderr for each finding, with exit code 1; under `--json` the
same findings are an object on stdout. Errors other than `StoneError` and the system's refusals (no permission, no
space) are program faults and keep their traceback.
"""

import errno
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from stone_base.counts import counted
from stone_base.errors import StoneError, one_line
from stone_base.findings import Finding
from stone_client.confirmation import NotConfirmedError
from stone_client.streams import echo_findings, echo_json, wants_json
from stone_submissions.errors import hint_of
from stone_submissions.verdict import Validation

REFUSED, WRONG_USAGE = 1, 2
MACHINE_SAYS_NO = {
    errno.EACCES: "not_permitted",
    errno.EPERM: "not_permitted",
    errno.EROFS: "not_permitted",
    errno.ENOSPC: "disk_full",
    errno.EDQUOT: "disk_full",
    errno.EFBIG: "disk_full",
}


class RefusingGroup(TyperGroup):
    """A group of commands whose `StoneError`s end as refusals."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except StoneError as error:
            exit_code = WRONG_USAGE if isinstance(error, NotConfirmedError) else REFUSED
            refuse([Finding(error.code, "error", "", str(error))], as_json=wants_json(ctx), exit_code=exit_code)
        except OSError as error:
            if error.errno not in MACHINE_SAYS_NO:
                raise
            code = MACHINE_SAYS_NO[error.errno]
            refuse([Finding(code, "error", "", f"{error.filename}: {error.strerror}")], as_json=wants_json(ctx))


def refuse(findings: Iterable[Finding], *, as_json: bool, exit_code: int = REFUSED) -> NoReturn:
    """Print each finding on a line of its own and end the command with `exit_code`."""
    shown = tuple(findings)
    echo_findings(shown)
    if as_json:
        echo_json({"findings": [finding.as_record() for finding in shown]})
    raise typer.Exit(exit_code)


def refuse_submission(validation: Validation, *, as_json: bool) -> NoReturn:
    """Print each problem of a submission on its own line and end the command with exit code 1."""
    refuse_report(validation.as_record(), as_json=as_json)


def refuse_report(report: Mapping[str, Any], *, as_json: bool) -> NoReturn:
    """Print the problems of a validation record, from here or a server; files with the same problem share a line."""
    alike = dict[tuple[str, str, str], list[str]]()
    for error in report["errors"]:
        expected = "" if error["code"] == "missing_frame" else error["expected"]
        alike.setdefault((error["code"], expected, error["actual"]), []).append(error["file"])
    for (code, expected, actual), files in alike.items():
        others = f"; {counted(len(files) - 1, 'more file')} of those listed" if len(files) > 1 else ""
        line = f"{code}: {files[0]}: expected {expected or files[0]}, found {actual}{others}"
        typer.echo(f"{one_line(line)} ({one_line(hint_of(code, expected, actual))})", err=True)
    if report["errors_total"] > len(report["errors"]):
        typer.echo(f"… and {report['errors_total'] - len(report['errors'])} more", err=True)
    if as_json:
        echo_json(report)
    raise typer.Exit(REFUSED)
