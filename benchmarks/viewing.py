"""What the viewer costs: milliseconds and bytes of each of its routes, and what labelling costs more for it.

    .venv/bin/python -m benchmarks.viewing --data stone-data

`--data` is the folder of a platform that labelled a sequence in public (`stone demo`). Milliseconds are of the
processor, so that what else this machine does is not counted; the first time a frame is asked for, and again. With
`--bag` (a recording with its calibration beside it) that is labelled by one process, and the share of its scene and
thumbnail is told.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient
from rich.console import Console
from rich.table import Table

from api.main import make_api
from services.ingest.opening import open_sequence
from services.labeler import thumbnail
from services.labeler.pipeline import LabelOptions, label
from services.labeler.scene_files import SceneFiles
from services.runtime.platform import open_platform
from services.runtime.settings import ApiSettings, Settings
from simulator.pipeline import calibration_path

URL = "/api/v1"
FRAMES = 40
COLUMNS = ("route", "asked", "first (ms)", "again (ms)", "bytes (mean)", "bytes (most)")
UNBOUND = ApiSettings(requests_per_minute=10**8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--bag", type=Path)
    options = parser.parse_args()
    platform = open_platform(Settings(data_folder=options.data, api=UNBOUND))
    table = Table(*COLUMNS, title="a frame, or a file, of the newest public sequence")
    with TestClient(make_api(platform)) as client:
        for shape, paths in routes(client):
            table.add_row(shape, *asked(client, paths))
    console = Console(width=120)
    console.print(table)
    if options.bag:
        console.print(labelling(options.bag))


def routes(client: TestClient) -> Iterator[tuple[str, list[str]]]:
    """(shape, paths) of each route."""
    sequence = next(one for one in client.get(f"{URL}/sequences").json()["items"] if one["labels"])
    at = f"{URL}/sequences/{sequence['id']}/scene"
    scene = client.get(at).json()
    tokens = scene["frames"]["tokens"][:: max(1, len(scene["frames"]["tokens"]) // FRAMES)]
    channel = next(iter(scene["playback"]["cameras"]), "CAM_FRONT")
    yield "scene", [at]
    yield "scene/tiles/{name}", [f"{at}/tiles/{one['name']}" for one in scene["tiles"]]
    yield "scene/meshes/{name}", [f"{at}/meshes/{one['name']}" for one in scene["meshes"]]
    for part in ("voxels", "bev.png", f"camera/{channel}.jpg", "cloud"):
        yield part, [f"{URL}/frames/{token}/{part}" for token in tokens]


def asked(client: TestClient, paths: list[str]) -> list[str]:
    """The row of a route."""
    first, sizes = zip(*(timed(client, path) for path in paths), strict=True)
    again, _ = zip(*(timed(client, path) for path in paths), strict=True)
    times = (statistics.median(first), statistics.median(again))
    return [str(len(paths)), *(f"{one:.1f}" for one in times), f"{statistics.mean(sizes):,.0f}", f"{max(sizes):,}"]


def timed(client: TestClient, path: str) -> tuple[float, int]:
    """Milliseconds of the processor, and bytes."""
    begun = time.process_time()
    answer = client.get(path)
    spent = (time.process_time() - begun) * 1e3
    answer.raise_for_status()
    return spent, len(answer.content)


def labelling(bag: Path) -> str:
    """How much of labelling the scene is."""
    meter = Meter()
    scene: Any = SceneFiles
    scene.add, scene.finish = meter.around(scene.add), meter.around(scene.finish)
    thumbnail.thumbnail = meter.around(thumbnail.thumbnail)
    with tempfile.TemporaryDirectory() as folder:
        sequence, sweeps = open_sequence(bag, calibration_path(bag), "measured")
        begun = time.process_time()
        label(sequence, sweeps, Path(folder) / "labels", LabelOptions())
        whole = time.process_time() - begun
    frames, share = len(sequence.frames), 100 * meter.spent / whole
    return f"{frames} frames in {whole:.1f} s of the processor; scene and thumbnail {meter.spent:.2f} s, {share:.1f} %"


class Meter:
    """Adds up the processor's seconds in some functions."""

    def __init__(self) -> None:
        self.spent = 0.0

    def around(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def measured(*given: Any) -> Any:
            begun = time.process_time()
            try:
                return function(*given)
            finally:
                self.spent += time.process_time() - begun

        return measured


if __name__ == "__main__":
    main()
