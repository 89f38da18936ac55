"""Our labels against the authors', for users with their data: `python -m benchmarks.release [FOLDER]`.

FOLDER contains the released ZIP, or the unpacked dataset, and one or more of its bags. Frames of a bag are matched to
the dataset's by stamps. The bag is labelled at the dataset's grid and ego origin with every profile, k, α and share of
kept voxels (docs/research/released-labels.md). The program prints a row for each setting, the closest first; for the
closest the confusion, the ratios by distance and the command to label with it. It writes an image of a frame of each
bag, ours beside theirs, to `--out`. Nothing of the dataset is unpacked. Without FOLDER it compares a twin: a simulated
bag of the release, and our labels of it.
"""

import argparse
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.release.pairs import ReleasedPair, bags_in, calibration_in, dataset_in, paired
from benchmarks.release.search import Agreement, Kept, Searched, Setting, Variant, findings_of, released_labels, search
from benchmarks.release.table import ordered, show_closest, show_findings, show_pair, show_settings
from services.domain.sequences.label_choices import PROFILES
from services.domain.viewer.frame_picture import comparison_picture
from services.labeler.parameters import chosen_parameters
from services.labeler.process_pool import Workers
from simulator.options import SimulateOptions
from stone.errors import StoneError
from stone_base.counts import counted
from stone_client.options import cores
from stone_files.grid_file import grid_text
from testing.worlds.released_pairs import make_pair

TWIN = SimulateOptions(10.0, 3, 32, columns=450, cameras=False, world_width_m=60.0)
TWIN_SETTING = Setting("paper", 20, 0.01)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="the released ZIP or dataset, and one or more bags")
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=PROFILES)
    parser.add_argument("--neighbours", type=int, nargs="+", default=(10, 20, 40), help="k of the roughness")
    parser.add_argument("--alphas", type=float, nargs="+", default=(0.01, 0.05, 0.2), help="α of the reference")
    parser.add_argument("--near-m", type=float, nargs="*", default=(0.4,), help="voxels kept by their distance to data")
    parser.add_argument("--sweeps", type=int, nargs="+", default=(0, 5), help="sweeps before and after that are data")
    parser.add_argument("--workers", type=int, default=cores())
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "stone-release")
    options = parser.parse_args()
    kept = (Kept(), *(Kept(near_m, sweeps) for near_m in options.near_m for sweeps in options.sweeps))
    searched = Searched(options.profiles, options.neighbours, options.alphas, kept)
    try:
        compare(options.folder or _twin(options.out / "twin"), searched, options.out, options.workers)
    except StoneError as error:
        sys.exit(f"{error.code}: {error}")


def _twin(folder: Path) -> Path:
    """Return a folder with a simulated bag of the release and a dataset with labels of it, created anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    made = make_pair(folder / "twin_rosbag", TWIN, chosen_parameters(TWIN_SETTING.profile, TWIN_SETTING.choices))
    made.write_zip(folder / "STONE.zip")
    return folder


def compare(folder: Path, searched: Searched, out: Path, workers: int) -> dict[Setting, Agreement]:
    """Print the agreement of each setting over all bags of a folder, and return it.

    A refused bag is named on stderr; if it is the last and none was compared, its error is raised. Raises `no_release`
    and a `DatasetFaultError`.
    """
    out.mkdir(parents=True, exist_ok=True)
    bags, index = bags_in(folder), dataset_in(folder)
    total, compared = dict[Setting, Agreement](), list[tuple[Path, str]]()
    for bag in bags:
        try:
            pair = paired(bag, index, out)
            agreements = _compare_bag(pair, searched, out, workers)
        except StoneError as error:
            if bag == bags[-1] and not compared:
                raise
            print(f"{bag.name} is skipped: {error.code}: {error}", file=sys.stderr)
            continue
        total = {key: total[key] + agreement if compared else agreement for key, agreement in agreements.items()}
        compared.append((bag, pair.name))
    show_settings(f"{counted(len(compared), 'bag')}, {len(total)} settings, the closest first", total)
    setting, agreement = ordered(total)[0]
    show_closest(setting, agreement)
    _show_command(setting, *compared[0], out)
    return total


def _compare_bag(pair: ReleasedPair, searched: Searched, out: Path, workers: int) -> dict[Setting, Agreement]:
    show_pair(pair)
    _grid_in(out, pair.name).write_text(grid_text(pair.reach))
    with tempfile.TemporaryDirectory(dir=out) as scratch, Workers(workers) as processes:
        agreements, variants = search(pair, searched, processes, Path(scratch))
        closest = ordered(agreements)[0][0]
        variant = variants[replace(closest, kept=Kept())]
        picture = out / f"{pair.name}.png"
        picture.write_bytes(_picture(pair, variant))
        print(f"  {picture}: a frame from above, A ours (all voxels) and B theirs, by the setting closest in this bag")
        show_findings(findings_of(variant, processes))
    return agreements


def _grid_in(out: Path, name: str) -> Path:
    return out / f"{name}.grid.json"


def _picture(pair: ReleasedPair, variant: Variant) -> bytes:
    """Return the picture of the middle one of the compared frames."""
    middle = len(pair.rows) // 2
    classes, is_known = released_labels(pair, middle)
    return comparison_picture(variant.frame(middle), (classes, is_known.astype(np.uint8)))


def _show_command(setting: Setting, bag: Path, name: str, out: Path) -> None:
    chosen = " ".join(f"--parameter {key}={value:g}" for key, value in setting.choices.items())
    print(
        f"\nTo label with these parameters (all voxels are kept):\n\nstone label {bag} "
        f"--calibration {calibration_in(out, name)} --ground auto --grid {_grid_in(out, name)} "
        f"--profile {setting.profile} {chosen} --output labels"
    )


if __name__ == "__main__":
    main()
