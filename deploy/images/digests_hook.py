"""Build hook: fixes the code versions in the wheel, so that all processes of all images of a build share them.

Hatchling runs it for every wheel (`pyproject.toml`). It writes the digests of the sources and the versions of the
libraries in `deploy/runtime.lock`, which the images install. A checkout that is installed in place computes its own.
"""

import json
import re
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LOCKED = re.compile(r"^([a-z0-9.-]+)==(\S+)", re.MULTILINE)


class DigestsHook(BuildHookInterface):
    """The hook that writes the file for `services/runtime/code_version.py`."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        sys.path.insert(0, self.root)
        from services.runtime.source_digests import SourceDigest, installed_places, record_of, source_digests

        locked = dict(LOCKED.findall((Path(self.root) / "deploy" / "runtime.lock").read_text("utf-8")))
        digests = {
            kind: SourceDigest(digest.sha256, {name: locked[name] for name in digest.libraries})
            for kind, digest in source_digests(installed_places()).items()
        }
        self._folder = TemporaryDirectory()
        path = Path(self._folder.name) / "source_digests.json"
        path.write_text(json.dumps(record_of(digests), indent=1) + "\n", "utf-8")
        build_data["force_include"][str(path)] = "services/runtime/source_digests.json"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if version != "editable":
            self._folder.cleanup()
