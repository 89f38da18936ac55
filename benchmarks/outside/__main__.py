"""Labels against analytic worlds that share no code with the simulator: `python -m benchmarks.outside`.

Every world is cast with every number of channels, recorded, labelled with every profile and judged by its exact truth;
faults are tried with `--fault-channels`. Ideal ranges and figures are stored in `--folder`: existing rows are reused
unless `--again` is given, and `--table` measures none. A row takes about half a minute; casting a world of 64 channels
takes 40 s more, once. `--set NAME=VALUE` tries a variant of the profiles on stored surfaces, which `--again` deletes.
"""

import argparse
import tempfile
from itertools import product
from pathlib import Path

from benchmarks.outside.remedies import ROWS
from benchmarks.outside.rows import Outcome, Row, kept, measure
from benchmarks.outside.table import Key, show
from benchmarks.outside.variants import forget, measure_variant
from services.domain.sequences.label_choices import PROFILES
from services.labeler.parameters import chosen_parameters
from testing.outside.drive import OutsideDrive
from testing.outside.faults import SOUND
from testing.outside.worlds import LAYOUTS


def main() -> None:
    options = _options()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.again:
        forget(options.folder)
    measured: dict[Key, list[Outcome]] = {}
    for row in _rows(options):
        outcome = None if options.again else kept(row, options.folder)
        if options.set:
            outcome = measure_variant(row, options.folder, chosen_parameters(row.profile, _choices(options.set)))
        elif outcome is None and not options.table:
            outcome = measure(row, options.folder)
            print(f"{row.drive.name}, {row.fault}, {row.profile}: {outcome.refused or 'labelled'}", flush=True)
        if outcome is not None:
            measured.setdefault((str(row.drive.channels), row.fault, row.profile), []).append(outcome)
    show(measured)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", nargs="+", choices=LAYOUTS, default=list(LAYOUTS))
    parser.add_argument("--channels", nargs="+", type=int, default=[16, 64, 128], help="of sound drives")
    parser.add_argument("--fault-channels", nargs="*", type=int, default=[64], help="for drives with faults")
    parser.add_argument("--faults", nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=list(PROFILES))
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-outside")
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="label parameters of a variant")
    parser.add_argument("--again", action="store_true", help="measure stored rows again")
    parser.add_argument("--table", action="store_true", help="only print stored figures")
    return parser.parse_args()


def _choices(texts: list[str]) -> dict[str, float]:
    """Return NAME=VALUE texts as values by name; a whole number is an integer."""
    pairs = [text.split("=", 1) for text in texts]
    return {name: int(value) if value.lstrip("-").isdigit() else float(value) for name, value in pairs}


def _rows(options: argparse.Namespace) -> list[Row]:
    """Return the rows of the table, in its order."""
    rows = []
    for channels, fault in product(sorted({*options.channels, *options.fault_channels}), options.faults):
        if channels in (options.channels if fault == SOUND else options.fault_channels):
            for profile, world, seed in product(options.profiles, options.worlds, options.seeds):
                rows.append(Row(OutsideDrive(world, channels, seed, options.seconds), fault, profile))
    return rows


if __name__ == "__main__":
    main()
