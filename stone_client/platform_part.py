"""The platform's commands if it is installed, and otherwise refusals that state what to install.

**Conventions.** No module of the platform is imported by name, because the client also works without it; `stone_local`
is looked up at its first use. A broken installation keeps its own traceback.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NoReturn

import typer

from stone_base.errors import Refused
from stone_client.lazy_commands import Place
from stone_client.streams import WANTS_JSON

PACKAGE = "stone_local"
PLATFORM_COMMANDS = (
    "simulate", "inspect", "calibration", "recover", "label", "export", "check", "ceiling",
    "model", "demo", "serve",
)  # fmt: skip


def is_platform_installed() -> bool:
    return find_spec(PACKAGE) is not None


def platform_places() -> Sequence[Place]:
    """Return the places of the platform's commands and groups; none if it is not installed."""
    if not is_platform_installed():
        return ()
    commands: Sequence[Place] = import_module(f"{PACKAGE}.registry").COMMANDS
    return commands


def platform_module(name: str, command: str) -> Any:
    """Return a module of the platform that `command` requires. Raises `platform_not_installed`."""
    if not is_platform_installed():
        raise platform_not_installed(command)
    return import_module(f"{PACKAGE}.{name}")


def add_refusals(app: typer.Typer) -> None:
    """Add hidden commands with the platform's names that refuse every call."""
    for name in PLATFORM_COMMANDS:
        words = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}
        app.command(name, hidden=True, context_settings=words)(_refusal_of(name))


def _refusal_of(name: str) -> Callable[[typer.Context], NoReturn]:
    def refuse_it(context: typer.Context) -> NoReturn:
        context.find_root().meta[WANTS_JSON] = "--json" in context.args
        raise platform_not_installed(name)

    return refuse_it


def platform_not_installed(command: str) -> Refused:
    return Refused(
        "platform_not_installed",
        f"`stone {command}` requires the platform, but only its client is installed; in a checkout of the platform "
        f"run `make install`, then `.venv/bin/stone {command}`",
    )
