"""A demo, created by `stone demo` once for all processes of a test run."""

from dataclasses import replace
from pathlib import Path

import pytest

from services.runtime.embedded.supervisor import running_platform
from services.runtime.settings import ApiSettings, Settings, ViewingSettings
from simulator.options import SimulateOptions
from stone_local.demo import pipeline
from stone_local.demo.pipeline import DemoPlan, run_demo
from testing.once import made_once
from testing.servers.fixtures import make_settings

SMALL = SimulateOptions(seconds=20.0, seed=3, channels=16, columns=180, cameras=False, lidar_hz=2, host_delay_max_ns=0)
"""The shortest run that a split's rule permits, with few sweeps."""
SPARSER = replace(pipeline.SPARSE, channels=16, columns=225, lidar_hz=1)
"""The demo's other two runs at full length, since short runs give no interval, with half of their sweeps."""


def demo_settings(folder: Path) -> Settings:
    return make_settings(folder, workers=2, api=ApiSettings(port=0), viewing=ViewingSettings())


def made_demo(factory: pytest.TempPathFactory) -> Path:
    """Return a folder with `demo`, the command's output, and `data`, its platform's folder; copy before changing it."""
    return made_once(factory, "small-demo", run_small_demo)


def run_small_demo(folder: Path) -> None:
    """Write `demo` into the folder, on the platform of its `data`."""
    (folder / "demo").mkdir()
    running_demo = running_platform(demo_settings(folder), is_awaited=False)
    with pytest.MonkeyPatch.context() as patch, running_demo as running:
        patch.setattr(pipeline, "SPARSE", SPARSER)
        run_demo(folder / "demo", DemoPlan(SMALL, running), lambda *_: None)
