"""Wheels as `make wheels` and the images build them."""

import subprocess
import sys
from pathlib import Path

import pytest


def built_wheel(project: Path, folder: Path) -> Path:
    """The wheel of the project in that folder, put into `folder`; without a network there is no backend for it."""
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(folder), str(project)]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, cwd=folder)
    if "hatchling" in outcome.stderr and "No matching distribution" in outcome.stderr:
        pytest.skip("hatchling cannot be fetched here, which builds the wheel")
    assert outcome.returncode == 0, outcome.stderr
    (built,) = folder.glob("*.whl")
    return built
