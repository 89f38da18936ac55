"""Build hook: takes the client's packages from where they lie, at the root of the project.

A checkout that is installed in place needs none of them: `dev-mode-dirs` of `pyproject.toml` names that root.
"""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGES = ("stone_base", "stone_files", "stone_submissions", "stone_client")


class PackagesHook(BuildHookInterface):
    """Hatchling runs it for every wheel of the client."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        root = Path(self.root).parents[1]
        build_data["force_include"].update({str(root / package): package for package in PACKAGES})
        build_data["force_include"][str(root / "LICENSE")] = "stone_client/LICENSE"
