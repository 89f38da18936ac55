"""The rounds of a kind: undisturbed runs to compare with, then a kill each, and the verdict on each.

**Conventions.** Round `n` of a kind under a seed draws the same moments and victims every time. A place in which
something was violated is closed and its folder stays; the next round opens another. What goes wrong while a round is
played is a violation of that round, with its reason, never the end of the suite.
"""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from chaos.inputs import Inputs
from chaos.kinds import Kind, undisturbed
from chaos.made import Made, made_by
from chaos.places import Place, opened_place
from chaos.turns import Struck, Turn, Undisturbed
from chaos.verdict import Violation, judge
from services.runtime.orm import Job
from services.runtime.processing import PROCESS, REGISTER


@dataclass(frozen=True)
class Suite:
    """What is asked for. No round begins after `until_s` of the monotonic clock."""

    seed: int
    rounds: int
    folder: Path
    inputs: Inputs
    until_s: float
    told: Callable[[str], None]
    undisturbed_runs: int = 2


@dataclass(frozen=True)
class Round:
    """How one ended. `recovered_s` is from the kill until the owner had what they came for; None: never."""

    number: int
    struck: tuple[Struck, ...]
    violations: tuple[Violation, ...]
    recovered_s: float | None

    @property
    def is_hit(self) -> bool:
        """Whether the kill hit work that was under way."""
        return any(struck.is_hit for struck in self.struck)


@dataclass
class Series:
    """The rounds of one kind so far, what undisturbed runs make, and what they take."""

    kind: Kind
    made: Made | None = None
    rounds: list[Round] = field(default_factory=list)
    undisturbed: Undisturbed = field(default_factory=Undisturbed)

    @property
    def is_proven(self) -> bool:
        """Work was hit, and nothing was lost, doubled or different for it."""
        is_hit = any(ended.is_hit for ended in self.rounds)
        return is_hit and not any(ended.violations for ended in self.rounds)


class UndisturbedError(Exception):
    """Runs that nobody disturbed are not as they should be, so nothing can be compared with them."""

    def __init__(self, kind: str, violations: list[Violation]) -> None:
        super().__init__(f"undisturbed, before the rounds of {kind!r}: {'; '.join(v.sentence for v in violations)}")


def play(suite: Suite, kind: Kind, made: Made | None = None) -> Series:
    """All rounds of a kind, in as many places as it takes: one, unless something is violated.

    `made` is what undisturbed runs made elsewhere. Raises `UndisturbedError`.
    """
    series, opened = Series(kind, made), 0
    while _goes_on(suite, series):
        opened += 1
        folder = suite.folder / f"{kind.name}-{opened}"
        where = {name: getattr(kind, name) for name in ("on_postgres", "on_s3", "uploads_in_store")}
        with opened_place(folder, suite.inputs, suite.told, **where) as place:
            _run_undisturbed(suite, series, place)
            while _goes_on(suite, series) and not place.is_kept:
                ended = _play_round(suite, series, place)
                series.rounds.append(ended)
                suite.told(_sentence(suite, series, ended))
                if ended.violations:
                    place.keep(_evidence(suite, series, ended))
    return series


def _goes_on(suite: Suite, series: Series) -> bool:
    return len(series.rounds) < suite.rounds and time.monotonic() < suite.until_s


def _run_undisturbed(suite: Suite, series: Series, place: Place) -> None:
    """The first run of a place warms it up, the last one's time counts, and all must make the same."""
    for number in range(suite.undisturbed_runs):
        turn = Turn(place, place.welcome(f"undisturbed-{number}"), Random(0), series.undisturbed)
        brought = undisturbed(turn)
        series.made = series.made or made_by(place.platform, brought)
        violations = judge(place.platform, brought, series.made)
        if violations:
            raise UndisturbedError(series.kind.name, violations)
        with place.platform.database.reading() as session:
            run = session.get_one(Job, brought.run_id)
        run_s = ((run.finished_ns or 0) - run.created_ns) / 1e9
        series.undisturbed = Undisturbed(run_s, _jobs_of(series.made))


def _jobs_of(made: Made) -> int:
    """Of the run itself."""
    return sum(count for kind, count in made.jobs.items() if kind not in (PROCESS, REGISTER))


def _play_round(suite: Suite, series: Series, place: Place) -> Round:
    number = len(series.rounds) + 1
    chance = Random(f"{suite.seed} {series.kind.name} {number}")
    turn = Turn(place, place.welcome(f"{series.kind.name}-{number}"), chance, series.undisturbed)
    recovered_s = None
    try:
        brought = series.kind.play(turn)
        recovered_s = time.monotonic() - turn.struck[-1].at_s
        found = [*turn.violations, *judge(place.platform, brought, series.made or Made())]
    except Exception as error:
        reason = "".join(traceback.format_exception(error, limit=-6)).strip()
        found = [*turn.violations, Violation("lost", f"the round did not end: {reason}")]
    return Round(number, tuple(turn.struck), tuple(found), recovered_s)


def _sentence(suite: Suite, series: Series, ended: Round) -> str:
    struck = ", ".join(f"{one.what}{'' if one.is_hit else ' (idle)'}" for one in ended.struck) or "nothing was struck"
    after = "never" if ended.recovered_s is None else f"after {ended.recovered_s:.1f} s"
    said = f"{series.kind.name} {ended.number}/{suite.rounds}: {struck}; recovered {after}"
    return "\n".join([said, *(f"  {one.sort}: {one.sentence}" for one in ended.violations)])


def _evidence(suite: Suite, series: Series, ended: Round) -> str:
    how = f"python -m chaos --only {series.kind.name} --seed {suite.seed} --rounds {ended.number}"
    return f"{how}\n{_sentence(suite, series, ended)}\n"
