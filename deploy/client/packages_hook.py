"""Build hook: copies the client's packages from the root of the project.

The packages that the client requires go into its folder `_vendor`, which `stone_client/__init__.py` adds to the path.
From the science packages only the modules of `stone_datasets`, the baseline and scoring are copied, which need numpy
alone. A checkout that is installed in place needs no copies: `dev-mode-dirs` of `pyproject.toml` names that root.
"""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

VENDORED = ("stone_base", "stone_files", "stone_submissions", "stone_exports", "stone_datasets")
SCIENCE = (
    "__init__.py", "errors.py", "geometry/__init__.py", "geometry/se3.py", "sensors/__init__.py",
    "labels/__init__.py", "labels/baseline.py", "scoring/__init__.py", "scoring/confusion.py",
    "scoring/frame_counts.py", "scoring/intervals.py", "scoring/metric.py", "scoring/numpy_counts.py",
    "scoring/plane_layout.py", "scoring/score_record.py", "scoring/signature.py", "scoring/spectra.py",
    "scoring/student.py", "scoring/truth_hash.py",
    "sensors/calibration.py", "sensors/projection.py", "splits/__init__.py", "splits/drives.py",
)  # fmt: skip


class PackagesHook(BuildHookInterface):
    """The hook that Hatchling runs for every wheel of the client."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        root, included = Path(self.root).parents[1], build_data["force_include"]
        included.update({str(root / package): f"stone_client/_vendor/{package}" for package in VENDORED})
        included.update({str(root / "stone" / module): f"stone_client/_vendor/stone/{module}" for module in SCIENCE})
        included[str(root / "stone_client")] = "stone_client"
        included[str(root / "LICENSE")] = "stone_client/LICENSE"
