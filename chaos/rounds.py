"""The rounds of a kind: undisturbed runs for comparison, then one kill per round and its verdict.

**Conventions.** Round `n` of a kind draws the same moments and victims for the same seed. After a violation the
platform is closed and its folder stays; the next round starts another platform. An error during a round is a violation
of that round, with its reason, and never ends the suite.
"""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from chaos.inputs import Inputs
from chaos.kinds import Kind, undisturbed
from chaos.places import PlatformUnderTest, platform_under_test
from chaos.result_hashes import RunArtefacts, made_by
from chaos.turns import OwnerRound, RoundKill, UndisturbedRun
from chaos.verdict import Violation, judge
from services.domain.sequences.processing import PROCESS, REGISTER
from services.runtime.orm import Job


@dataclass(frozen=True)
class Suite:
    """The parameters of the suite. No round starts after `until_s` of the monotonic clock."""

    seed: int
    rounds: int
    folder: Path
    inputs: Inputs
    until_s: float
    report: Callable[[str], None]
    undisturbed_runs: int = 2


@dataclass(frozen=True)
class KillRound:
    """A finished round. `recovered_s` is the time from the kill to the owner's result; None without a result."""

    number: int
    struck: tuple[RoundKill, ...]
    violations: tuple[Violation, ...]
    recovered_s: float | None

    @property
    def is_hit(self) -> bool:
        """Whether the kill hit running work."""
        return any(struck.is_hit for struck in self.struck)


@dataclass
class RoundSeries:
    """The finished rounds of one kind, and the results and times of undisturbed runs."""

    kind: Kind
    made: RunArtefacts | None = None
    rounds: list[KillRound] = field(default_factory=list)
    undisturbed: UndisturbedRun = field(default_factory=UndisturbedRun)

    @property
    def is_proven(self) -> bool:
        """Whether work was hit, and nothing was lost, doubled or different."""
        is_hit = any(ended.is_hit for ended in self.rounds)
        return is_hit and not any(ended.violations for ended in self.rounds)


class UndisturbedError(Exception):
    """Undisturbed runs failed or differ, so there is no result to compare with."""

    def __init__(self, kind: str, violations: list[Violation]) -> None:
        super().__init__(f"undisturbed, before the rounds of {kind!r}: {'; '.join(v.sentence for v in violations)}")


def play(suite: Suite, kind: Kind, made: RunArtefacts | None = None) -> RoundSeries:
    """Play all rounds of a kind, on one platform unless a violation occurs.

    `made` are the results of undisturbed runs elsewhere. Raises `UndisturbedError`.
    """
    series, opened = RoundSeries(kind, made), 0
    while _goes_on(suite, series):
        opened += 1
        folder = suite.folder / f"{kind.name}-{opened}"
        where = {name: getattr(kind, name) for name in ("on_postgres", "on_s3", "uploads_in_store")}
        with platform_under_test(folder, suite.inputs, suite.report, **where) as target:
            run_undisturbed(suite, series, target)
            play_in(suite, series, target)
    return series


def play_in(suite: Suite, series: RoundSeries, target: PlatformUnderTest) -> None:
    """Play rounds on a warm platform until all are played or a violation occurs."""
    while _goes_on(suite, series) and not target.is_kept:
        ended = _play_round(suite, series, target)
        series.rounds.append(ended)
        suite.report(_sentence(suite, series, ended))
        if ended.violations:
            target.keep(_evidence(suite, series, ended))


def _goes_on(suite: Suite, series: RoundSeries) -> bool:
    return len(series.rounds) < suite.rounds and time.monotonic() < suite.until_s


def run_undisturbed(suite: Suite, series: RoundSeries, target: PlatformUnderTest) -> None:
    """Play undisturbed runs: the first warms the platform up, the last is timed, and all must agree.

    Raises `UndisturbedError`.
    """
    for number in range(suite.undisturbed_runs):
        turn = OwnerRound(target, target.welcome(f"undisturbed-{number}"), Random(0), series.undisturbed)
        brought = undisturbed(turn)
        series.made = series.made or made_by(target.platform, brought)
        violations = judge(target.platform, brought, series.made)
        if violations:
            raise UndisturbedError(series.kind.name, violations)
        with target.platform.database.reading() as session:
            run = session.get_one(Job, brought.run_id)
        run_s = ((run.finished_ns or 0) - run.created_ns) / 1e9
        series.undisturbed = UndisturbedRun(run_s, _jobs_of(series.made))


def _jobs_of(made: RunArtefacts) -> int:
    """Return the number of jobs of the run itself."""
    return sum(count for kind, count in made.jobs.items() if kind not in (PROCESS, REGISTER))


def _play_round(suite: Suite, series: RoundSeries, target: PlatformUnderTest) -> KillRound:
    number = len(series.rounds) + 1
    chance = Random(f"{suite.seed} {series.kind.name} {number}")
    turn = OwnerRound(target, target.welcome(f"{series.kind.name}-{number}"), chance, series.undisturbed)
    recovered_s = None
    try:
        brought = series.kind.play(turn)
        recovered_s = time.monotonic() - turn.struck[-1].at_s
        violations = [*turn.violations, *judge(target.platform, brought, series.made or RunArtefacts())]
    except Exception as error:
        reason = "".join(traceback.format_exception(error, limit=-6)).strip()
        violations = [*turn.violations, Violation("lost", f"the round did not end: {reason}")]
    return KillRound(number, tuple(turn.struck), tuple(violations), recovered_s)


def _sentence(suite: Suite, series: RoundSeries, ended: KillRound) -> str:
    struck = (
        ", ".join(f"{entry.what}{'' if entry.is_hit else ' (idle)'}" for entry in ended.struck) or "nothing was struck"
    )
    after = "never" if ended.recovered_s is None else f"after {ended.recovered_s:.1f} s"
    line = f"{series.kind.name} {ended.number}/{suite.rounds}: {struck}; recovered {after}"
    return "\n".join([line, *(f"  {entry.sort}: {entry.sentence}" for entry in ended.violations)])


def _evidence(suite: Suite, series: RoundSeries, ended: KillRound) -> str:
    how = f"python -m chaos --only {series.kind.name} --seed {suite.seed} --rounds {ended.number}"
    return f"{how}\n{_sentence(suite, series, ended)}\n"
