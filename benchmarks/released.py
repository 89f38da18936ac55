"""Reading the released dataset's layout: `python -m benchmarks.released`.

Prints the cost of reading the directory of a ZIP as large as the release (sparse: its files have no bytes) in a process
of its own. Then prints the shares of returns in occupied voxels of a simulated twin, with right and wrong layouts.
"""

import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import UUID

from stone_base.label_grid import RELEASE
from stone_datasets.classes import OWN_CLASSES
from stone_datasets.grid_fit import STATED, measured_fit
from stone_datasets.reading import read_dataset
from stone_datasets.stated_layout import UNSTATED, StatedLayout
from stone_datasets.zip_files import open_zip
from stone_files.archives import CENTRAL, FULL32, zip_end
from stone_files.dataset_layouts import LAYOUTS, RELEASE_FACTS
from testing.worlds.released_datasets import (
    CAMERAS,
    ReleasedDataset,
    RowChange,
    with_quaternions_last,
    write_released_zip,
)

FILE_BYTES = RELEASE_FACTS.zip_bytes // RELEASE_FACTS.zip_entries
TWIN = ReleasedDataset(frames=6)
STAMP = "n001-2025-08-22-07-14-16+0900"


def release_names() -> Iterator[str]:
    """Yield as many file names as the release has."""
    root = LAYOUTS["release"].roots[0]
    yield f"{root}/v1.0-trainval/scene.json"
    for frame in range(RELEASE_FACTS.scenes * RELEASE_FACTS.frames_a_scene * 2):
        yield f"{root}/gts/scene-{frame // RELEASE_FACTS.frames_a_scene}/{UUID(int=frame)}/labels.npz"
        for channel in (*CAMERAS, "LIDAR_TOP"):
            yield f"{root}/samples/{channel}/{STAMP}__{channel}__{1755846856000000 + frame * 100000}.bin"


def write_sparse_zip(path: Path) -> None:
    """Write a ZIP that consists of a directory alone."""
    directory, at = bytearray(), 0
    with path.open("wb") as file:
        for _, name in zip(range(RELEASE_FACTS.zip_entries), release_names(), strict=False):
            extra = struct.pack("<2HQ", 1, 8, at) if at >= FULL32 else b""
            sizes = (FILE_BYTES - 200, FILE_BYTES, len(name), len(extra))
            head = CENTRAL.pack(b"PK\1\2", 45, 45, 0, 8, 0, 33, 0, *sizes, 0, 0, 0, 0, min(at, FULL32))
            directory += head + name.encode() + extra
            at += FILE_BYTES
        file.write(b"PK\3\4")
        file.seek(at)
        file.write(directory + zip_end(RELEASE_FACTS.zip_entries, at, len(directory)))


def peak_mib() -> float:
    """Return the peak memory of this program; `ru_maxrss` also includes its parent's."""
    text = Path("/proc/self/status").read_text().partition("VmHWM:")[2]
    return int(text.split()[0]) / 1024


def measure_index(path: Path) -> None:
    """Read the directory in this process, and print the cost."""
    before, begun = peak_mib(), time.process_time()
    files = open_zip(path)
    cpu_s, more = time.process_time() - begun, peak_mib() - before
    held = files.keys.nbytes + files.places.nbytes
    print(f"{len(files.keys)} files of {path.stat().st_size / 1e9:.0f} GB: {cpu_s:.1f} CPU-s, {held / 1e6:.1f} MB held")
    print(f"({held / len(files.keys):.0f} bytes a file), {more:.0f} MiB more at its peak")


def measure_fit(name: str, what: ReleasedDataset, stated: StatedLayout = UNSTATED) -> None:
    """Print the share with the given layout, and with the best other layout."""
    with TemporaryDirectory() as folder:
        index = read_dataset(write_released_zip(Path(folder) / "twin.zip", what), stated)
        fit = measured_fit(index, list(index.sequences), OWN_CLASSES)
    for kind, shares in (("own frame", fit.own), ("frame near by", fit.pairs)):
        best = max((layout for layout in shares if layout != STATED), key=lambda layout: shares[layout])
        print(f"{name:32} {kind:14} {shares[STATED]:8.2%}   {best}: {shares[best]:.2%}")


def main() -> None:
    if len(sys.argv) > 1:
        measure_index(Path(sys.argv[1]))
        return
    with TemporaryDirectory() as folder:
        write_sparse_zip(Path(folder) / "sparse.zip")
        subprocess.run([sys.executable, "-m", "benchmarks.released", f"{folder}/sparse.zip"], check=True)
    small = replace(RELEASE, name="card", min_m=(-20.0, -20.0, -1.0), voxel_m=0.2)
    for name, layout in LAYOUTS.items():
        measure_fit(f"right, {name}", replace(TWIN, layout=layout))
    for axis, low in (("x", (-39.8, -40.0, -1.0)), ("z", (-40.0, -40.0, -0.8))):
        measure_fit(f"half a voxel off in {axis}", replace(TWIN, labels_in=replace(RELEASE, name="moved", min_m=low)))
    measure_fit("0.2 m stated, 0.4 m written", TWIN, StatedLayout(grid=small))
    for table in ("calibrated_sensor", "ego_pose"):
        measure_fit(f"x y z w in {table}", replace(TWIN, changed=_turned(table)))


def _turned(only: str) -> RowChange:
    return lambda table, row: with_quaternions_last(table, row) if table == only else row


if __name__ == "__main__":
    main()
