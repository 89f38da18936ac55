"""The script of a simulated season, drawn from its seed: submissions, withdrawals and cheats.

**Conventions.** A play's levels are the quality of each of its frames, 0 the best. Teams improve during the season. One
team probes with nearly equal submissions; another copies a third team's submission.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.season.world import LEVELS, SeasonSize

Spoil = Literal["", "missing", "broken"]
SPOILS: tuple[Spoil, ...] = ("missing", "broken")
PROBING, COPYING, COPIED = 0, 1, 2
INVALID_RATIO, WITHDRAWN_RATIO, HIDDEN_RATIO = 0.04, 0.03, 0.01


@dataclass(frozen=True)
class Play:
    """One submission: its team, its sender (captain or member), and its later fate."""

    number: int
    team: int
    is_captain: bool
    levels: tuple[int, ...]
    spoil: Spoil
    is_withdrawn: bool
    is_hidden: bool


def plan_of(size: SeasonSize) -> tuple[Play, ...]:
    """Return every play of the season, in the order of their starts."""
    return tuple(_plays(size, np.random.default_rng(size.seed)))


def _plays(size: SeasonSize, random: np.random.Generator) -> Iterator[Play]:
    skill = random.uniform(1, LEVELS - 1, size.teams)
    sent: dict[int, tuple[int, ...]] = {}
    for number in range(size.submissions):
        team, turn = number % size.teams, number // size.teams
        fresh = _levels(random, skill[team] * (1 - 0.4 * number / size.submissions), size.sequences * size.frames)
        is_copied = team == COPYING and COPIED in sent and random.random() < 0.3
        levels = sent[COPIED] if is_copied else _probe(sent[team], turn) if team == PROBING and turn else fresh
        sent[team] = sent.get(team, levels) if team == PROBING else levels
        fate = random.random()
        yield Play(
            number=number,
            team=team,
            is_captain=bool(random.random() < 0.5),
            levels=levels,
            spoil=SPOILS[number % 2] if random.random() < INVALID_RATIO else "",
            is_withdrawn=bool(fate < WITHDRAWN_RATIO),
            is_hidden=bool(WITHDRAWN_RATIO <= fate < WITHDRAWN_RATIO + HIDDEN_RATIO),
        )


def _levels(random: np.random.Generator, level: float, frames: int) -> tuple[int, ...]:
    """Return levels around this one, drawn for each frame."""
    return tuple(np.clip(np.rint(level + random.normal(0, 1, frames)), 0, LEVELS - 1).astype(int).tolist())


def _probe(levels: tuple[int, ...], turn: int) -> tuple[int, ...]:
    """Return the levels with one frame slightly changed."""
    changed = turn % len(levels)
    return tuple((level + 1) % LEVELS if index == changed else level for index, level in enumerate(levels))
