"""Draw the maps of the FAQ and of "Bring your robot" from a simulated run, with and without faults: `make pictures`.

Each picture is the `bev.png` of one label set. Look at the pictures before you commit them.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate

IMAGES = Path(__file__).parents[1] / "docs" / "images"
RUN = SimulateOptions(
    seconds=12.0, seed=4, channels=32, columns=450, cameras=False, traffic="none", beside_track=True, speed_m_s=2.5
)  # fmt: skip
LEGEND_PX = 60
BLUE = 150  # a pixel of class T has more blue, and less red


def _as_it_is(calibration: str) -> str:
    return calibration


def _low_lidar(calibration: str) -> str:
    """Return the calibration with the LiDAR 0.14 m too low. Raises ValueError if it has another mount than expected."""
    before, mount, after = calibration.partition("translation_m: [0.0, 0.0, 0.95]")
    if not mount:
        raise ValueError("the simulated LiDAR is not mounted at (0, 0, 0.95) m: change this picture's fault")
    return f"{before}translation_m: [0.0, 0.0, 0.81]{after}"


def _strict_limits(calibration: str) -> str:
    """Return the calibration of a vehicle that drives on nearly level ground only."""
    return f"{calibration}vehicle: {{max_slope_deg: 2, max_step_m: 0.02}}\n"


@dataclass(frozen=True)
class RobotPicture:
    """A picture: the change of the run's calibration, and further options of `stone label`.

    `reach_px` of the map are shown around the track, enlarged `zoom` times.
    """

    name: str
    change: Callable[[str], str] = _as_it_is
    options: tuple[str, ...] = ()
    reach_px: int = 260
    zoom: int = 1


PICTURES = (
    RobotPicture("mount-right", reach_px=60, zoom=2),
    RobotPicture("mount-low", change=_low_lidar, reach_px=60, zoom=2),
    RobotPicture("faq-red", change=_strict_limits),
    RobotPicture("faq-smeared", options=("--time-offset", "lidar=0.4s")),
)


def draw(picture: RobotPicture, folder: Path) -> None:
    """Label the run in `folder` with the picture's calibration and options, and write the picture."""
    bag = folder / "run.mcap"
    calibration = folder / f"{picture.name}.yaml"
    calibration.write_text(picture.change(calibration_path(bag).read_text("utf-8")), "utf-8")
    labels = folder / picture.name
    command = [sys.executable, "-m", "stone_client.main", "label", str(bag), "--calibration", str(calibration)]
    subprocess.run([*command, "-o", str(labels), *picture.options], check=True)
    with Image.open(labels / "bev.png") as map_above:
        around_track(map_above.convert("RGBA"), picture).save(IMAGES / f"{picture.name}.png", optimize=True)


def around_track(map_above: Image.Image, picture: RobotPicture) -> Image.Image:
    """Return the part of the map around class T, on white."""
    paper = Image.new("RGBA", map_above.size, "white")
    paper.alpha_composite(map_above)
    red, _, blue = np.moveaxis(np.asarray(paper.convert("RGB")).astype(int), 2, 0)
    is_legend = np.arange(paper.height)[:, None] > paper.height - LEGEND_PX
    rows, columns = np.nonzero((blue > BLUE) & (blue > 2 * red) & ~is_legend)
    left, upper = max(int(columns.min()) - picture.reach_px, 0), max(int(rows.min()) - picture.reach_px, 0)
    right, lower = int(columns.max()) + picture.reach_px, int(rows.max()) + picture.reach_px
    part = paper.crop((left, upper, min(right, paper.width), min(lower, paper.height))).convert("RGB")
    return part.resize((picture.zoom * part.width, picture.zoom * part.height), Image.Resampling.NEAREST)


def draw_all(names: list[str]) -> None:
    """Draw the pictures of these names, or all of them."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "run.mcap", RUN)
        for picture in PICTURES:
            if not names or picture.name in names:
                draw(picture, Path(folder))


if __name__ == "__main__":
    draw_all(sys.argv[1:])
