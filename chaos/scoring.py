"""kill −9 while submissions are scored: `python -m chaos.scoring [--rounds 50] [--seed N] [--folder DIR]`.

Each round submits a file and strikes at a random moment of its scoring. The victim is a process of the pool, the worker
with its whole pool, or the sandboxed child that reads the file. Then it waits for the end and compares everything with
an undisturbed submission of the same file. The exit code is 1 if anything was lost, doubled or different, or if too few
kills hit work.
"""

import argparse
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random, SystemRandom
from statistics import median

from rich.console import Console
from sqlalchemy import select

from chaos.places import API, JOBS, STORE, WORKERS
from chaos.scoring_verdict import SubmissionOutcome, came_of, judge, judge_quota
from chaos.scoring_world import build_scoring_world, files
from chaos.turns import TERMINAL, await_true
from chaos.verdict import Violation, judge_blobs
from services.runtime.embedded.child_process import Child
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.orm import Job, JobAttempt, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from testing.process_tree import sandboxed_children_of
from testing.worlds.benchmark_world import World
from testing.worlds.sending import send

VICTIMS = {"pool process": 2, "sandboxed child": 2, "worker and pool": 1}  # how often out of five
MOST_TRIES = 3  # a round without a hit is repeated, up to this multiple of all rounds
LOOK_S = 0.002
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


@dataclass(frozen=True)
class ScoringKill:
    """The victim, and the kind of its job; empty if no work was running."""

    victim: str
    kind: str
    at_s: float


@dataclass(frozen=True)
class ScoringRound:
    """A finished round; `recovered_s` is from the kill to the end of the run."""

    struck: ScoringKill
    recovered_s: float
    violations: tuple[Violation, ...]


@dataclass(frozen=True, eq=False)
class ScoringPlatform:
    """A running platform, the files to submit, and their undisturbed results and times."""

    running: RunningPlatform
    world: World
    contents: Mapping[str, bytes]
    expected: dict[str, SubmissionOutcome] = field(default_factory=dict)
    run_s: dict[str, float] = field(default_factory=dict)

    @property
    def platform(self) -> Platform:
        return self.running.platform

    @property
    def worker(self) -> Child:
        return next(child for child in self.running.children if child.program.name == "worker")

    def state(self, submission_id: str) -> str:
        """Return the state of the run."""
        with self.platform.database.reading() as session:
            run = select(Job.state).join(SubmissionRow, SubmissionRow.job_id == Job.id)
            return session.scalars(run.where(SubmissionRow.id == submission_id)).one()

    def finish(self, submission_id: str) -> None:
        await_true(f"the end of submission {submission_id}", lambda: self.state(submission_id) in TERMINAL)

    def at_work(self, submission_id: str) -> tuple[str, int] | None:
        """Return the kind of a running job of the submission and the process that has it."""
        running = (
            select(Job.kind, JobAttempt.worker)
            .join(JobAttempt, (JobAttempt.job_id == Job.id) & (JobAttempt.number == Job.attempt))
            .join(SubmissionRow, SubmissionRow.job_id == Job.root_id)
            .where(SubmissionRow.id == submission_id, Job.state == "running", Job.queue != "")
        )
        with self.platform.database.reading() as session:
            row = session.execute(running.limit(1)).first()
        return (row[0], int(row[1].rpartition(":")[2])) if row else None

    def ended_jobs(self, submission_id: str) -> int:
        with self.platform.database.reading() as session:
            of_run = select(Job.state).join(SubmissionRow, SubmissionRow.job_id == Job.root_id)
            states = session.scalars(of_run.where(SubmissionRow.id == submission_id, Job.queue != "")).all()
        return sum(state in TERMINAL for state in states)


def rehearse(arena: ScoringPlatform) -> None:
    """Record the undisturbed results of each file; the second run is timed, with warm workers."""
    for name, content in arena.contents.items():
        for _ in range(2):
            begun_s = time.monotonic()
            submission_id = send(arena.world, content)
            arena.finish(submission_id)
            arena.run_s[name] = time.monotonic() - begun_s
            arena.expected[name] = came_of(arena.platform, submission_id)
    states = {name: came.state for name, came in arena.expected.items()}
    if Counter(states.values()) != {"scored": 2, "invalid": 1}:
        raise RuntimeError(f"undisturbed, the files came to {states}")


def play(arena: ScoringPlatform, chance: Random) -> ScoringRound:
    """Play one round: submit, strike, wait, judge."""
    name, team = chance.choice(sorted(arena.contents)), chance.randrange(2)
    submission_id = send(arena.world, arena.contents[name], team=team)
    struck = kill_one(arena, submission_id, name, chance)
    arena.finish(submission_id)
    recovered_s = time.monotonic() - struck.at_s
    quota = judge_quota(arena.platform, arena.world.val, arena.world.teams[team])
    return ScoringRound(struck, recovered_s, (*judge(arena.platform, submission_id, arena.expected[name]), *quota))


def kill_one(arena: ScoringPlatform, submission_id: str, name: str, chance: Random) -> ScoringKill:
    """Kill a victim that works on the submission, a while after a random number of its jobs have ended."""
    (victim,), jobs = chance.choices(list(VICTIMS), list(VICTIMS.values())), sum(arena.expected[name].jobs.values())
    is_reading = victim == "sandboxed child"  # joins do not read the file again, and children read only briefly
    after = chance.randrange(jobs - is_reading)
    await_true("so many jobs", lambda: arena.ended_jobs(submission_id) >= after, every_s=LOOK_S)
    time.sleep(0.0 if is_reading else chance.random() * arena.run_s[name] / jobs / 2)
    work = _await_work(arena, submission_id, is_reading=is_reading)
    if work is None:
        return ScoringKill(victim, "", time.monotonic())
    kind, pid = work
    if victim == "worker and pool":
        arena.worker.forgive()
        os.killpg(arena.worker.pid, signal.SIGKILL)
    else:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return ScoringKill(victim, kind, time.monotonic())


def lines_of_round(number: int, rounds: int, ended: ScoringRound) -> str:
    """Return a line for the round, and one for each violation."""
    what = f"{ended.struck.victim} in {ended.struck.kind}" if ended.struck.kind else "no work was running"
    line = f"{number}/{rounds}: {what}; ended {ended.recovered_s:.1f} s later"
    return "\n".join([line, *(f"  {violation.sort}: {violation.sentence}" for violation in ended.violations)])


def summary(played: list[ScoringRound], blobs: list[Violation]) -> str:
    """Return the hits, the violations and the recovery times in words."""
    hits = Counter(f"{ended.struck.victim} in {ended.struck.kind}" for ended in played if ended.struck.kind)
    violations = [violation for ended in played for violation in ended.violations] + blobs
    sorts = Counter(violation.sort for violation in violations)
    seconds = sorted(ended.recovered_s for ended in played if ended.struck.kind) or [0.0]
    counted = ", ".join(f"{count} × {what}" for what, count in sorted(hits.items()))
    return (
        f"{len(played)} rounds, {hits.total()} hit work ({counted}); "
        f"lost {sorts['lost']}, doubled {sorts['doubled']}, differing {sorts['differing']}; "
        f"ended {median(seconds):.1f} s after the kill (median), {seconds[-1]:.1f} s at most"
    )


def main() -> int:
    options = _options()
    CONSOLE.print(f"seed {options.seed}, folder {options.folder}")
    settings = Settings(
        data_folder=options.folder, workers=WORKERS, jobs=replace(JOBS, rest_s=0.2), store=STORE, api=API
    )
    world = build_scoring_world(settings)
    contents, played = files(world), list[ScoringRound]()
    with running_platform(settings, lambda line: None) as running:
        arena = ScoringPlatform(running, replace(world, platform=running.platform), contents)
        rehearse(arena)
        while _hits(played) < options.rounds and len(played) < MOST_TRIES * options.rounds:
            played.append(play(arena, Random(f"{options.seed} {len(played)}")))
            CONSOLE.print(lines_of_round(_hits(played), options.rounds, played[-1]))
        blobs = list(judge_blobs(running.platform))
    CONSOLE.print(summary(played, blobs))
    is_proven = _hits(played) == options.rounds and not blobs
    return 0 if is_proven and not any(ended.violations for ended in played) else 1


def _hits(played: list[ScoringRound]) -> int:
    return sum(bool(ended.struck.kind) for ended in played)


def _await_work(arena: ScoringPlatform, submission_id: str, *, is_reading: bool) -> tuple[str, int] | None:
    """Return the kind and the process of a running job, or its reading child; None once the run is over."""
    while arena.state(submission_id) not in TERMINAL:
        work = arena.at_work(submission_id)
        if work is not None and not is_reading:
            return work
        children = sandboxed_children_of(arena.worker.pid)
        if work is not None and children:
            return work[0], children[0]
        time.sleep(LOOK_S)
    return None


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos.scoring", description=__doc__)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=SystemRandom().randrange(2**31))
    parser.add_argument("--folder", type=Path, help="folder of the rounds (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-scoring-"))).absolute()
    return options


if __name__ == "__main__":
    sys.exit(main())
