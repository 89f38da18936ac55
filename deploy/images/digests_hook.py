"""Build hook: writes the digests of the sources into the wheel, so that an image says what it was built from.

Hatchling runs it for every wheel (`pyproject.toml`); a checkout that is installed in place has none, and computes them.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class DigestsHook(BuildHookInterface):
    """`services/runtime/code_version.py` reads the file."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        sys.path.insert(0, self.root)
        from services.runtime.source_digests import source_digests

        self._folder = TemporaryDirectory()
        path = Path(self._folder.name) / "source_digests.json"
        path.write_text(json.dumps(source_digests(), indent=1) + "\n", "utf-8")
        build_data["force_include"][str(path)] = "services/runtime/source_digests.json"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if version != "editable":
            self._folder.cleanup()
