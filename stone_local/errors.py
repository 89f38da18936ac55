"""Errors of commands that need the platform here."""

from typing import ClassVar

from stone.errors import StoneError


class NoTorchError(StoneError):
    """PyTorch is not installed where the command runs."""

    code: ClassVar[str] = "no_torch"

    def __init__(self, missing: str) -> None:
        super().__init__(
            f"{missing} is not installed here: run `make baselines`, then .venv-baselines/bin/stone with the same "
            "arguments (or pip install 'stone-platform[baselines]')"
        )
