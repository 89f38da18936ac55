"""Labels of real recordings against known facts: `python -m benchmarks.real [FOLDER]`.

It labels every recording of the folder that has a description (docs/research/real-ground.md lists its contents) with
every profile and with one option at a time. It prints figures without a ground truth: ground that faces down, T under
the track, N on known flat ground and walls, and points of known class. It also prints the agreement of labels from a
part of the track with the rest, and the difference of two passes. FOLDER defaults to STONE_FIELD_DATA, or else the
tests' usual folder; if the default is missing, the program prints a note and succeeds. A given folder without
descriptions is an error. `--names` selects recordings, `--options` and `--profiles` rows; two passes are tried for the
rows of `--passes-of`, since each labels everything twice more.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.real.description import Described, described_in, own_descriptions
from benchmarks.real.errors import NothingDescribedError
from benchmarks.real.held_out import held_out_figures
from benchmarks.real.labelled_map import Figures, disagreement, read_map
from benchmarks.real.measures import WrittenLabels, measured
from benchmarks.real.opening import part_of
from benchmarks.real.semantic_agreement import agreement, semantic_counts
from benchmarks.real.table import show
from benchmarks.real.variants import OPTIONS, PROFILES, Option, options_of, rows_of_pass
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters
from services.labeler.report import LabelReport
from stone.errors import StoneError
from stone.labels.profiles import Profile
from stone.sensors.sequence import Sequence, SweepSource
from testing.field_data import VARIABLE, field_folder

WORKERS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="folder of recordings")
    parser.add_argument("--names", nargs="+", help="only recordings with these names of descriptions")
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=PROFILES)
    parser.add_argument("--options", nargs="+", help="only rows with these names in the table")
    parser.add_argument("--passes-of", nargs="*", default=[OPTIONS[0].name], help="rows to try in two passes")
    parser.add_argument(
        "--out", type=Path, default=Path(tempfile.gettempdir()) / "stone-real", help="folder for labels"
    )
    options = parser.parse_args()
    try:
        recordings = described_recordings(options.folder)
    except StoneError as error:
        sys.exit(f"{error.code}: {error}")
    chosen = [
        recording for recording in recordings if options.names is None or recording.description.name in options.names
    ]
    if recordings and not chosen:
        sys.exit(f"no description has one of these names: {', '.join(options.names)}")
    for described in chosen:
        _show_recording(described, options)


def described_recordings(folder: Path | None) -> list[Described]:
    """Return the described recordings of the folder; None means the usual folder, which may be missing (with a note).

    Raises `NothingDescribedError` for a given folder without any, and what `described_in` raises.
    """
    is_named = folder is not None or bool(os.environ.get(VARIABLE))
    chosen = folder or field_folder()
    recordings = described_in(chosen) if chosen.is_dir() else []
    if not recordings and is_named:
        raise NothingDescribedError(chosen, len(own_descriptions()))
    if not recordings:
        print(f"no real recordings on this machine; give a folder, or set {VARIABLE}")
    return recordings


def _show_recording(described: Described, options: argparse.Namespace) -> None:
    rows: dict[tuple[str, str], Figures] = {}
    for option in options_of(described):
        if options.options is None or option.name in options.options:
            for profile in (name for name in options.profiles if name in option.profiles):
                rows[profile, option.name] = _row(described, (profile, option), options)
    show(f"{described.description.name}: {described.description.about}", rows)


def _row(described: Described, how: tuple[Profile, Option], options: argparse.Namespace) -> Figures:
    """Return the figures of one label set, or the code of its refusal."""
    profile, option = how
    folder: Path = options.out / described.description.name
    folder.mkdir(parents=True, exist_ok=True)
    try:
        sequence, sweeps = option.opened(described)
        parameters = option.parameters(profile)
        labels = folder / f"{profile} {option.name}".replace("/", " ")
        held = Figures()
        kept = LabelOptions(parameters, WORKERS, at_end=lambda run: held.update(held_out_figures(run)))
        figures = _figures(described, label(sequence, sweeps, labels, kept), labels) | held
        if option.name in options.passes_of:
            figures |= _passes(described, (sequence, sweeps), parameters, folder)
    except StoneError as error:
        print(f"{described.description.name}, {profile}, {option.name}: {error.code}: {error}", file=sys.stderr)
        return {"refused": error.code}
    return figures


def _figures(described: Described, report: LabelReport, folder: Path) -> Figures:
    labels, semantics = WrittenLabels(described, report.sequence, folder), described.description.semantics
    known = {} if semantics is None else agreement(semantic_counts(labels, semantics), semantics)
    return {
        **measured(labels),
        **known,
        "held_out": report.held_out["recall"],
        "held_out_m": report.held_out["judged_m"],
        "p_share": report.class_shares()["potentially_traversable"],
        "reference": float(report.reference.voxels),
        "sigma_deg": float(np.rad2deg(np.sqrt(report.reference.covariance[1, 1]))),
    }


def _passes(
    described: Described, run: tuple[Sequence, SweepSource], parameters: LabelParameters, folder: Path
) -> Figures:
    """Return the difference of two passes, labelled alike; each leaves out the frames of the other."""
    figures: Figures = {}
    for kind in described.description.passes if len(run[0].frames) > 1 else ():
        maps = []
        for number, rows in enumerate(rows_of_pass(kind, len(run[0].frames))):
            labels = folder / f"{kind}-{number}"
            label(*part_of(*run, rows), labels, LabelOptions(parameters, WORKERS))
            maps.append(read_map(labels))
        figures[f"{kind}_differs"], figures[f"{kind}_n"] = disagreement(*maps)
    return figures


if __name__ == "__main__":
    main()
