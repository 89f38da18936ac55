"""Coverage of intervals and separation of equal entries: `python -m benchmarks.intervals [--trials 1000]`.

In worlds with known truth (`testing/worlds/correlated_scores.py`) two entries are scored like on the platform. The
table shows the number of trials with a statement, the coverage of the 95 % interval for the true mIoU, and the misses
of the interval for the difference. The true difference is 0 in a new place and nearly 0 in these places. A second table
counts the boards of equally good entries that make a statement, use these places, and separate any two entries.
"""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binom

from stone.scoring.confusion import ratios
from stone.scoring.intervals import LEVEL, SCOPES, Estimate, Scope, estimates, ratio_spectra
from stone.scoring.metric import RATIOS
from stone.scoring.pairs import board_spectra, entry_spectra, surely_above
from testing.worlds.correlated_scores import CorrelatedWorld, trial, true_miou

MIOU = RATIOS.index("miou")
FRAMES, SEQUENCES, RHOS = (200, 300, 600, 1200), (1, 3, 5, 10), (0.0, 0.5, 0.9, 0.98)
UNEQUAL: tuple[tuple[int, ...], ...] = ((5000, *[200] * 4), (1200, 200, 300, 600), (210,) * 5, (250, 1100, 420))
OTHER: tuple[tuple[int, ...], ...] = ((1200,) * 3, (600,) * 5, (300,) * 10)
NOISE = 0.7
PAPER = (1400,) * 5
LONG: tuple[tuple[int, ...], ...] = (PAPER, (400,) * 5, (600,) * 3, (300,) * 10, (1200,), (5000,))
HURSTS = (0.6, 0.7, 0.8, 0.9)
CHANCE = 0.001
SPEAKS = 0.1
MOST_FRAMES = 3_000_000  # limit per row; rows of many frames have fewer trials


@dataclass
class ScopeCounts:
    """Counts over the trials of a row, in one scope."""

    stated: int = 0
    covered: int = 0
    compared: int = 0
    missed: int = 0


@dataclass(frozen=True)
class IntervalRow:
    world: CorrelatedWorld
    trials: int
    of_scope: dict[Scope, ScopeCounts]


@dataclass(frozen=True)
class BoardTrials:
    """Boards of equal entries: counts of all, with a statement, with one by these places, with any separated pair."""

    world: CorrelatedWorld
    entries: int
    trials: int
    stated: int
    here: int
    split: int


def measured(world: CorrelatedWorld, trials: int, seed: int) -> IntervalRow:
    """Return a row of the table."""
    random = np.random.default_rng([seed, *world.frames_of_sequence, round(1000 * world.memory)])
    row = IntervalRow(world, trials, {scope: ScopeCounts() for scope in SCOPES})
    spread = float(np.hypot(world.place, world.own_place))
    anywhere = true_miou([1.0], np.zeros(1), spread)
    for _ in range(trials):
        drawn = trial(world, random)
        values = [ratios(confusions.sum(axis=0)) for confusions in drawn.confusions]
        spectra = [ratio_spectra(confusions, world.frames_of_sequence) for confusions in drawn.confusions]
        truths: dict[Scope, tuple[float, float]] = {
            "these_places": (drawn.true_here[0], drawn.true_here[0] - drawn.true_here[1]),
            "new_place": (anywhere, 0.0),
        }
        for scope, counts in row.of_scope.items():
            estimate = estimates(values[0], spectra[0], scope)[MIOU]
            of_both = estimates(values[0] - values[1], spectra[0].minus(spectra[1]), scope)[MIOU]
            _count(counts, estimate, of_both, truths[scope])
    return row


def _count(counts: ScopeCounts, estimate: object, of_both: object, truth: tuple[float, float]) -> None:
    if isinstance(estimate, Estimate):
        low, high = estimate.ratio_interval()
        counts.stated += 1
        counts.covered += low <= truth[0] <= high
    if isinstance(of_both, Estimate):
        low, high = of_both.interval()
        counts.compared += 1
        counts.missed += not low <= truth[1] <= high


def boards(world: CorrelatedWorld, entries: int, trials: int, seed: int) -> BoardTrials:
    """Return boards whose entries are all equally good on this ground."""
    random = np.random.default_rng([seed, entries, *world.frames_of_sequence])
    stated = here = split = 0
    for _ in range(trials):
        drawn = trial(world, random, entries)
        values = np.array([ratios(confusions.sum(axis=0))[MIOU] for confusions in drawn.confusions])
        spectra = [ratio_spectra(confusions, world.frames_of_sequence) for confusions in drawn.confusions]
        order = np.argsort(-values)
        separation = surely_above(
            values[order], board_spectra([entry_spectra(spectra[index], MIOU) for index in order])
        )
        if separation is not None:
            stated += 1
            here += separation.scope == "these_places"
            split += bool(separation.above.any())
    return BoardTrials(world, entries, trials, stated, here, split)


def worlds() -> Iterator[CorrelatedWorld]:
    """Yield the rows of the table."""
    for sequences, frames, rho in product(SEQUENCES, FRAMES, RHOS):
        yield CorrelatedWorld((frames,) * sequences, rho)
    for lengths, rho in product(UNEQUAL, (0.5, 0.9)):
        yield CorrelatedWorld(lengths, rho)
    for lengths in OTHER:
        yield CorrelatedWorld(lengths, 0.9, noise=NOISE)
        yield CorrelatedWorld(lengths, 19, "window")
    yield from long_memory_worlds()


def long_memory_worlds() -> Iterator[CorrelatedWorld]:
    """Yield worlds with long memory, and other worlds of the same lengths beside them."""
    for lengths in LONG:
        for hurst in HURSTS:
            yield CorrelatedWorld(lengths, hurst, "fractional")
        yield CorrelatedWorld(lengths, 0.85, "fractional", noise=0.5)
        yield CorrelatedWorld(lengths, 30, "regimes")
    yield CorrelatedWorld(PAPER, 150, "regimes")
    for length in (19, 256, 512):
        yield CorrelatedWorld(PAPER, length, "window")
    for rho in (0.0, 0.9, 0.98, 0.995):
        yield CorrelatedWorld(PAPER, rho)
    for rho in (0.9, 0.98):
        yield CorrelatedWorld((5000,), rho)


def board_worlds() -> Iterator[CorrelatedWorld]:
    """Yield worlds whose entries are equally good in every sequence."""
    for rho in (0.0, 0.9):
        yield CorrelatedWorld((300,) * 10, rho, own_place=0.0)
    for rho in (0.9, 0.98, 0.995):
        yield CorrelatedWorld(PAPER, rho, own_place=0.0)
    for hurst in HURSTS[1:]:
        yield CorrelatedWorld(PAPER, hurst, "fractional", own_place=0.0)
    yield CorrelatedWorld(PAPER, 0.85, "fractional", noise=0.5, own_place=0.0)
    yield CorrelatedWorld(PAPER, 512, "window", own_place=0.0)
    yield CorrelatedWorld(PAPER, 150, "regimes", own_place=0.0)


def show(rows: Sequence[IntervalRow], of_boards: Sequence[BoardTrials]) -> None:
    console = Console(width=130)
    table = Table(title=f"Intervals of {100 * LEVEL:.0f} %, mIoU: stated / covers / difference missed, %")
    for column in ("sequences × frames", "memory", "trials", "these places", "a new place"):
        table.add_column(column, justify="left" if column == "sequences × frames" else "right")
    for row in rows:
        scopes = (_percents(row.of_scope[scope], row.trials) for scope in SCOPES)
        table.add_row(_name(row.world), f"{row.world.memory:g}", str(row.trials), *scopes)
    console.print(table)
    for scope in SCOPES:
        console.print(_summary(scope, rows))
    table = Table(title="Boards of equal entries: stated / by these places / any two separated, %")
    for column in ("sequences × frames", "memory", "entries", "boards", "told apart"):
        table.add_column(column, justify="left" if column == "sequences × frames" else "right")
    for trials in of_boards:
        shares = ((trials.stated, trials.trials), (trials.here, trials.trials), (trials.split, trials.stated))
        figures = " / ".join(_share(*share) for share in shares)
        table.add_row(_name(trials.world), f"{trials.world.memory:g}", str(trials.entries), str(trials.trials), figures)
    console.print(table)


def _summary(scope: Scope, rows: Sequence[IntervalRow]) -> str:
    """Return a summary of all rows, the worst rows, and the rows that miss the aims significantly."""
    counts = [row.of_scope[scope] for row in rows]
    spoken = [row for row in rows if row.of_scope[scope].stated > SPEAKS * row.trials]
    least = min((row.of_scope[scope].covered / row.of_scope[scope].stated for row in spoken), default=float("nan"))
    stated, compared = sum(count.stated for count in counts), sum(count.compared for count in counts)
    covered, missed = sum(count.covered for count in counts), sum(count.missed for count in counts)
    beyond = [_name(row.world) for row in rows if _is_beyond(row.of_scope[scope])]
    return (
        f"{scope.replace('_', ' ')}, all rows: {_share(covered, stated)} % of {stated} intervals cover, at the least "
        f"{100 * least:.1f} % of a row with statements in more than {100 * SPEAKS:.0f} % of trials. "
        f"{_share(missed, compared)} % of {compared} differences are missed. Below 93 % or above 6 % by more than "
        f"chance (p < {CHANCE:g} a row): {', '.join(beyond) or 'none'}"
    )


def _is_beyond(counts: ScopeCounts) -> bool:
    low = binom.cdf(counts.covered, counts.stated, 0.93) if counts.stated else 1.0
    apart = binom.sf(counts.missed - 1, counts.compared, 0.06) if counts.compared else 1.0
    return bool(min(low, apart) < CHANCE)


def _name(world: CorrelatedWorld) -> str:
    lengths = world.frames_of_sequence
    name = f"{len(lengths)} × {lengths[0]}" if len(set(lengths)) == 1 else " + ".join(map(str, lengths))
    kind = "" if world.kind == "first_order" else f", {world.kind}"
    return f"{name}{kind}{', noisy' if world.noise else ''}"


def _percents(counts: ScopeCounts, trials: int) -> str:
    if not counts.stated and not counts.compared:
        return "silent"
    covered, missed = _share(counts.covered, counts.stated), _share(counts.missed, counts.compared)
    return f"{_share(counts.stated, trials)} / {covered} / {missed}"


def _share(part: int, whole: int) -> str:
    """Return the share in per cent; in brackets for few trials, whose error is a few points."""
    if not whole:
        return "–"
    return f"{100 * part / whole:.1f}" if whole >= 200 else f"({100 * part / whole:.0f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="only rows whose names contain this text")
    options = parser.parse_args()
    with ProcessPoolExecutor() as pool:
        rows = [
            pool.submit(measured, world, _trials(world, options.trials), options.seed)
            for world in worlds()
            if options.only in _name(world)
        ]
        of_boards = [
            pool.submit(boards, world, entries, options.trials // 2, options.seed)
            for world in board_worlds()
            for entries in (2, 20)
            if options.only in _name(world)
        ]
        show([future.result() for future in rows], [future.result() for future in of_boards])


def _trials(world: CorrelatedWorld, most: int) -> int:
    return min(most, max(200, MOST_FRAMES // sum(world.frames_of_sequence)))


if __name__ == "__main__":
    main()
