"""The results of `benchmarks.release` as tables for a docs page."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.release.pairs import ReleasedPair
from benchmarks.release.search import Agreement, Setting
from stone.findings import Finding
from stone.labels.profiles import RULES
from stone.scoring.agreement import BOTH_FREE, DIFFERENCES, differences
from stone.scoring.confusion import ratios
from stone.scoring.metric import CLASS_NAMES, CLASSES

RINGS_M = ("0 to 10 m", "10 to 20 m", "from 20 m")
RATIOS = ("IoU_occ", "IoU_T", "IoU_P", "IoU_N", "mIoU")


def ordered(agreements: Mapping[Setting, Agreement]) -> list[tuple[Setting, Agreement]]:
    """Return the settings, the closest first."""
    return sorted(agreements.items(), key=lambda item: item[1].rank)


def show_pair(pair: ReleasedPair) -> None:
    """Print how the frames of a bag and of the dataset were matched, and by code the sweeps that are no frames."""
    off_us, apart_m = np.abs(pair.off_ns) // 1000, np.median(pair.apart_m)
    print(
        f"\n{pair.name}: {len(pair.rows)} of {len(pair.sequence.frames)} frames have released labels "
        f"({np.count_nonzero(off_us == 0)} by equal stamps, the others at most {off_us.max() / 1000:.3f} ms off). The "
        f"median distance of the LiDAR by the bag and by the tables is {apart_m:.3f} m. "
        f"The released ego origin is {pair.ours_from_theirs.translation_m[2]:.2f} m above the ground."
    )
    codes = Counter(finding.code for finding in pair.sequence.excluded)
    for code, frames in codes.items():
        print(f"  {code}: {frames} sweeps of the bag have no frame")


def show_findings(findings: Iterable[Finding]) -> None:
    """Print a line for each code, with the message of its first finding."""
    by_code = dict[str, list[Finding]]()
    for finding in findings:
        by_code.setdefault(finding.code, []).append(finding)
    for code, findings_of_code in sorted(by_code.items()):
        times = f" ({len(findings_of_code)} times)" if len(findings_of_code) > 1 else ""
        print(f"  {findings_of_code[0].severity} {code}{times}: {findings_of_code[0].message}")


def show_settings(title: str, agreements: Mapping[Setting, Agreement]) -> None:
    """Print a row for each setting, the closest first."""
    table = _table("profile", "height", "k", "α", "kept voxels", *RATIOS, "ours, unknown in theirs")
    for setting, agreement in ordered(agreements):
        height = "above local ground" if RULES[setting.profile].is_local else "absolute"
        shown = (setting.profile, height, str(setting.neighbours), f"{setting.alpha:g}", str(setting.kept))
        table.add_row(*shown, *map(_share, agreement.ratios), _share(agreement.beyond / max(agreement.labelled, 1)))
    _print(title, table)


def show_closest(setting: Setting, agreement: Agreement) -> None:
    """Print the confusion of one setting, its ratios by distance, and the kinds of differences."""
    whole = agreement.confusion.sum(axis=0)
    table = _table("released", *(f"ours {name}" for name in CLASS_NAMES))
    for name, row in zip(CLASS_NAMES, whole.tolist(), strict=True):
        table.add_row(name, *(f"{count:,}" for count in row))
    _print(f"voxels of {setting.profile}, k {setting.neighbours}, α {setting.alpha:g}, kept: {setting.kept}", table)
    by_ring = _table("distance", *RATIOS, "released T", "P", "N")
    for name, of_ring in zip(RINGS_M, agreement.confusion, strict=True):
        by_ring.add_row(name, *map(_share, ratios(of_ring).tolist()), *map(_share, _classes(of_ring)))
    _print("by distance", by_ring)
    print("\nshares of the voxels labelled by A (ours) or B (theirs):")
    for name, share in ways_to_differ(whole).items():
        print(f"  {name}: {_share(share)}")


def ways_to_differ(confusion: NDArray[np.int64]) -> dict[str, float]:
    """Return the shares of a confusion [theirs, ours] by `DIFFERENCES`, A ours; free in both is left out."""
    theirs, ours = np.indices((CLASSES, CLASSES)).astype(np.uint8)
    counts = np.bincount(differences(ours, theirs).ravel(), confusion.ravel(), len(DIFFERENCES))
    counts[BOTH_FREE] = 0
    shares = counts / max(counts.sum(), 1)
    return {name: float(shares[code]) for code, name in enumerate(DIFFERENCES) if code != BOTH_FREE}


def _classes(confusion: NDArray[np.int64]) -> Sequence[float]:
    """Return the shares of T, P and N in the occupied voxels of the released labels."""
    occupied = confusion.sum(axis=1)[1:]
    return [float(count) for count in occupied / max(int(occupied.sum()), 1)]


def _share(value: float) -> str:
    return "" if np.isnan(value) else f"{100 * value:.2f} %"


def _table(*columns: str) -> Table:
    table = Table(box=box.MARKDOWN)
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def _print(title: str, table: Table) -> None:
    print(f"\n{title}\n")
    Console(width=max(Console().width, 200)).print(table)
