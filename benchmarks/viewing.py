"""What the viewer costs: milliseconds and bytes of each of its routes.

    .venv/bin/python -m benchmarks.viewing --data stone-data

`--data` is the folder of a platform that labelled a sequence in public (`stone demo`). Milliseconds are of the
processor, so that what else this machine does is not counted; the first time a frame is asked for, and again.
"""

import argparse
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
from rich.console import Console
from rich.table import Table

from api.main import make_api
from services.runtime.platform import open_platform
from services.runtime.settings import ApiSettings, Settings
from tests.api.serving import serving

URL = "/api/v1"
FRAMES = 40
COLUMNS = ("route", "asked", "first (ms)", "again (ms)", "bytes (mean)", "bytes (most)")
UNBOUND = ApiSettings(requests_per_minute=10**8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    options = parser.parse_args()
    platform = open_platform(Settings(data_folder=options.data, api=UNBOUND))
    table = Table(*COLUMNS, title="a frame, or a file, of the newest public sequence")
    with serving(platform, make_api(platform)) as url, httpx.Client(base_url=url) as client:
        for shape, paths in routes(client):
            table.add_row(shape, *asked(client, paths))
    Console(width=120).print(table)


def routes(client: httpx.Client) -> Iterator[tuple[str, list[str]]]:
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


def asked(client: httpx.Client, paths: list[str]) -> list[str]:
    """The row of a route."""
    first, sizes = zip(*(timed(client, path) for path in paths), strict=True)
    again, _ = zip(*(timed(client, path) for path in paths), strict=True)
    times = (statistics.median(first), statistics.median(again))
    return [str(len(paths)), *(f"{one:.1f}" for one in times), f"{statistics.mean(sizes):,.0f}", f"{max(sizes):,}"]


def timed(client: httpx.Client, path: str) -> tuple[float, int]:
    """Milliseconds of the processor, and bytes."""
    begun = time.process_time()
    answer = client.get(path)
    spent = (time.process_time() - begun) * 1e3
    answer.raise_for_status()
    return spent, len(answer.content)


if __name__ == "__main__":
    main()
