"""A demo, as `stone demo` leaves it, made once for all processes of a test run."""

from pathlib import Path

import pytest

from services.runtime.embedded.supervisor import running_platform
from services.runtime.settings import ApiSettings, Settings, ViewingSettings
from simulator.options import SimulateOptions
from stone_local.demo.pipeline import DemoPlan, run_demo
from testing.once import made_once
from testing.servers.fixtures import make_settings

SMALL = SimulateOptions(seconds=20.0, seed=3, channels=24, columns=240, cameras=False)


def demo_settings(folder: Path) -> Settings:
    return make_settings(folder, workers=2, api=ApiSettings(port=0), viewing=ViewingSettings())


def made_demo(factory: pytest.TempPathFactory) -> Path:
    """A folder with `demo`, what the command leaves, and `data`, of the platform that made it; to be copied."""
    return made_once(factory, "small-demo", _make)


def _make(folder: Path) -> None:
    (folder / "demo").mkdir()
    with running_platform(demo_settings(folder), is_awaited=False) as running:
        run_demo(folder / "demo", DemoPlan(SMALL, running), lambda *_: None)
