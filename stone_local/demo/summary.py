"""The last lines of `stone demo`: addresses, classes of the labels, leaders of the board, and the next step."""

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stone_client.progress import bytes_of, duration

MEANINGS = (
    ("traversable", "traversable (driven over)"),
    ("potentially_traversable", "potentially traversable (ground like that, not driven over)"),
    ("non_traversable", "non-traversable (all other surface)"),
)
NO_BOARD = "none: the platform has other splits or a changed password, or the run is too short for a split"


def summary_lines(record: Mapping[str, Any], folders: tuple[Path, ...], spent_s: float, *, stays: bool) -> list[str]:
    """Return six lines about a demo; the first of its folders is the output, a second is the platform's data.

    `stays` is whether the server at the record's address keeps running.
    """
    output, labels = folders[0], record["labels"]
    shares = labels["class_share_of_occupied"]
    classes = ", ".join(f"{100 * shares[name]:.1f} % {meaning}" for name, meaning in MEANINGS)
    sizes = ", ".join(f"{_from_here(folder)} ({bytes_of(_size_bytes(folder))})" for folder in folders)
    again = "" if stays else f" (first start the server: {own_command()} serve)"
    return [
        f"3D view  {record['url']}{record['view']}{again}",
        f"Picture  {output / 'labels' / 'bev.png'}",
        f"Labels   {labels['frames']} frames, occupied voxels: {classes}",
        f"Board    {_board_line(record)}",
        f"Files    {sizes}; the demo took {duration(spent_s)}",
        f"Next     label your own bag: {own_command()} label BAG --calibration ROBOT.yaml -o labels; without a "
        f"calibration start with: {own_command()} calibration init BAG -o ROBOT.yaml",
    ]


def own_command() -> str:
    """Return the command that runs this `stone`: the bare name if the shell finds it, else its path."""
    run_as = Path(sys.argv[0])
    if shutil.which("stone") == str(run_as.resolve()) or run_as.name != "stone":
        return "stone"
    return str(_from_here(run_as))


def _from_here(path: Path) -> Path:
    """Return the path relative to the current folder if it is below it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _board_line(record: Mapping[str, Any]) -> str:
    """Return the best ranked method and the best baseline, by mIoU, and the address of the board."""
    if not record["benchmark"]:
        return NO_BOARD
    board = record["benchmark"]["board"]
    return f"{', '.join(_leaders(board['rows']))}: {record['url']}/benchmarks/{board['benchmark']}/{board['phase']}"


def _leaders(rows: list[Mapping[str, Any]]) -> Iterator[str]:
    for standing, title in (("ranked", "rank 1"), ("baseline", "baseline")):
        candidates = [row for row in rows if row["standing"] == standing]
        if candidates:
            best = max(candidates, key=lambda row: row["ratios"]["miou"])
            yield f"{title} “{best['method']}” mIoU {100 * best['ratios']['miou']:.1f} %"


def _size_bytes(folder: Path) -> int:
    """Return the bytes of all files; a file with several names counts once."""
    stats = (path.stat() for path in folder.rglob("*") if path.is_file())
    return sum({stat.st_ino: stat.st_size for stat in stats}.values())
