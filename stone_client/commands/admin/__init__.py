"""`stone admin`: the work of administrators."""

from typing import Annotated

import typer

RequiredReason = Annotated[str, typer.Option("--reason", metavar="TEXT", help="Reason, recorded in the audit log.")]
