"""What the tests of uploading share: bags of a simulated robot, a slow line, what the platform kept.

**Conventions.** A bag is simulated once in a process. The line is slowed in the browser itself, so that something can
happen in the middle of a file.
"""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import yaml  # type: ignore[import-untyped]
from playwright.sync_api import Locator, Page
from sqlalchemy import select

from services.runtime.orm import Recording, Upload
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import simulate

TINY = SimulateOptions(seconds=1.0, seed=3, channels=16, columns=120, cameras=False)
BULKY = SimulateOptions(seconds=1.0, seed=4, channels=64, columns=1024, cameras=False)
"""Some 20 MB: more than one piece."""


@cache
def bag(options: SimulateOptions = TINY, name: str = "run") -> Path:
    """A recording that the platform reads without a word."""
    path = Path(mkdtemp(prefix="stone-bag-")) / f"{name}.mcap"
    simulate(path, options)
    return path


def slow_down(page: Page, bytes_per_s: float) -> None:
    """No more than this leaves the browser from now on; -1 lifts it."""
    limits = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": bytes_per_s}
    page.context.new_cdp_session(page).send("Network.emulateNetworkConditions", limits)


def row_of(page: Page, name: str) -> Locator:
    """The line of the bag so called."""
    return page.locator(".transfer").filter(has=page.locator("strong", has_text=name))


def choose(page: Page, *paths: Path) -> None:
    page.locator("[data-uploader] [data-files]").set_input_files(list(paths))


def uploads(platform: Platform) -> list[Upload]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Upload).order_by(Upload.id)))


def recordings(platform: Platform) -> list[Recording]:
    with platform.database.reading() as session:
        return list(session.scalars(select(Recording).order_by(Recording.id)))


def moved(source: Path, target: Path, by_m: float) -> Path:
    """The calibration with its first sensor that much higher."""
    said = yaml.safe_load(source.read_text())
    first = next(iter(said["sensors"].values()))
    first["lidar_from_sensor"]["translation_m"][2] += by_m
    target.write_text(yaml.safe_dump(said))
    return target
