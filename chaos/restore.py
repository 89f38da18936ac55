"""A drill of backup and restore under load: `python -m chaos.restore [--postgres] [--s3] [--folder DIR]`.

First, one recording is labelled and one submission scored. Then backups are taken one after another during other work:
a second owner's run, a second scoring, a half-sent file, readers and writers. The platform is killed, its data,
database and bucket are emptied, the newest backup is restored, and work continues. Every artefact and score must be
equal, and unfinished work must end as it would have. Otherwise the exit code is 1.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random

from rich.console import Console
from sqlalchemy import select

from chaos.api_calls import (
    HalfSent,
    await_jobs,
    await_run,
    begin_run,
    offset_of,
    seconds_since,
    send_half,
    send_rest,
    upload_sequence,
)
from chaos.inputs import Inputs, simulated
from chaos.load import under_load
from chaos.places import API, JOBS, STORE, VIEWING, WORKERS, PlatformUnderTest, RoundOwner
from chaos.result_hashes import OwnerRun, RunArtefacts, made_by
from chaos.scoring_verdict import SubmissionOutcome, came_of
from chaos.scoring_world import build_scoring_world, files
from chaos.turns import OwnerRound, UndisturbedRun, await_true
from chaos.verdict import Violation, judge, judge_blobs
from services.runtime.backup.capture import make_backup
from services.runtime.backup.folder import BackupFolder
from services.runtime.backup.restore import restore
from services.runtime.backup.retention import verify
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.orm import Job, SubmissionRow
from services.runtime.platform import open_platform, open_silent_platform
from services.runtime.settings import DatabaseSettings, Settings, StoreSettings
from stone_client.api import Api
from testing.servers.postgres import PostgresServer, running_postgres
from testing.servers.s3 import running_s3
from testing.worlds.benchmark_world import World
from testing.worlds.sending import send

AFTER_JOBS = 5
BACKUPS = 3
MIB = 2**20
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


@dataclass(frozen=True)
class RestoreTarget:
    """A platform that can be emptied: its settings and its servers."""

    settings: Settings
    postgres: PostgresServer | None

    def empty(self) -> Settings:
        """Return settings of a fresh database and bucket, without a data folder."""
        shutil.rmtree(self.settings.root)
        if self.postgres is not None:
            self.postgres.run("DROP DATABASE stone WITH (FORCE)")
            self.postgres.run("CREATE DATABASE stone")
        if self.settings.store.s3_bucket:
            store = open_platform(self.settings).store
            for stored in list(store.listed("")):
                store.delete(stored.key)
        return self.settings


@dataclass(frozen=True)
class BackedUpState:
    """The finished and unfinished work at the last backup."""

    done: OwnerRun
    made: RunArtefacts
    under_way: OwnerRun
    scored_id: str
    came: SubmissionOutcome
    scoring_id: str
    half: HalfSent
    owner: RoundOwner


def main() -> int:
    options = _options()
    inputs, folder = simulated(options.folder / "inputs"), BackupFolder(options.folder / "backups")
    with _ground(options) as ground:
        before = work(ground, inputs, folder)
        CONSOLE.print(f"verified: {len(verify(folder).damaged)} damaged")
        begun_s = time.monotonic()
        platform = open_silent_platform(ground.empty())
        restored = restore(platform, folder)
        platform.database.close()
        CONSOLE.print(
            f"restored {restored.rows} rows, {restored.objects} objects, {restored.uploads} uploads in "
            f"{seconds_since(begun_s)}; {restored.queued_again} running jobs queued again"
        )
        violations = go_on(ground, before)
    for violation in violations:
        CONSOLE.print(f"{violation.sort}: {violation.sentence}")
    CONSOLE.print(f"{len(violations)} violations; folder {options.folder}")
    return 1 if violations else 0


def work(ground: RestoreTarget, inputs: Inputs, folder: BackupFolder) -> BackedUpState:
    """Fill the platform, back it up during work, and kill it at the end."""
    world = build_scoring_world(ground.settings)
    contents = sorted(files(world).items())
    with running_platform(ground.settings, CONSOLE.print) as running:
        world, target = replace(world, platform=running.platform), PlatformUnderTest(running, inputs)
        done = _labelled(target, "first", inputs)
        scored_id = _scored(world, contents[0][1])
        owner = target.welcome("second")
        turn = OwnerRound(target, owner, Random(0), UndisturbedRun())
        with turn.connected() as api, under_load(turn):
            half, under_way = send_half(api), begin_run(api, upload_sequence(api, inputs), inputs)
            await_jobs(api, under_way.run_id, AFTER_JOBS)
            scoring_id = send(world, contents[1][1], team=1)
            _back_up(running, folder)
        for violation in turn.violations:
            CONSOLE.print(f"under load: {violation.sentence}")
        made, came = made_by(running.platform, done), came_of(running.platform, scored_id)
        for child in running.children:
            child.kill()
    return BackedUpState(done, made, under_way, scored_id, came, scoring_id, half, owner)


def go_on(ground: RestoreTarget, before: BackedUpState) -> list[Violation]:
    """Start again; compare results, and the ends of unfinished work, with the state before."""
    violations: list[Violation] = []
    with running_platform(ground.settings, CONSOLE.print) as running:
        platform = running.platform
        with Api(replace(before.owner.server, url=running.url)) as api:
            if offset_of(api, before.half) == 0:
                violations.append(Violation("lost", "the half-sent file has no bytes left"))
            if (state := send_rest(api, before.half)) != "complete":
                violations.append(Violation("lost", f"the half-sent file is {state}"))
            await_run(api, before.under_way.run_id)
        _await_scored(running, before.scoring_id)
        if made_by(platform, before.done) != before.made:
            violations.append(Violation("differing", "the labels differ from those before the backup"))
        if came_of(platform, before.scored_id) != before.came:
            violations.append(Violation("differing", "the scores differ from those before the backup"))
        if (state := came_of(platform, before.scoring_id).state) != before.came.state:
            violations.append(Violation("lost", f"the submission in scoring is {state}"))
        judged = judge(platform, before.under_way, before.made)
        violations += [violation for violation in judged if "beside the used upload" not in violation.sentence]
        return [*violations, *judge_blobs(platform)]


def _back_up(running: RunningPlatform, folder: BackupFolder) -> None:
    """Take several backups in a row: the first is large, the others run during changes."""
    for _ in range(BACKUPS):
        begun_s = time.monotonic()
        taken = make_backup(running.platform, folder)
        with running.platform.database.reading() as session:
            jobs = session.scalars(select(Job.state).where(Job.state == "running", Job.queue != "")).all()
        CONSOLE.print(
            f"backup of {taken.blobs} blobs in {seconds_since(begun_s)}: {taken.brought} files, "
            f"{taken.brought_bytes / MIB:.1f} MiB new; {len(jobs)} jobs running; {len(taken.snapshot.flaws)} flaws"
        )


def _labelled(target: PlatformUnderTest, name: str, inputs: Inputs) -> OwnerRun:
    with Api(target.welcome(name).server) as api:
        brought = begin_run(api, upload_sequence(api, inputs), inputs)
        await_run(api, brought.run_id)
        return brought


def _scored(world: World, content: bytes) -> str:
    submission_id = send(world, content)
    await_true("the first submission's score", lambda: came_of(world.platform, submission_id).scores != ())
    return submission_id


def _await_scored(running: RunningPlatform, submission_id: str) -> None:
    def has_ended() -> bool:
        with running.platform.database.reading() as session:
            return session.get_one(SubmissionRow, submission_id).settled_ns is not None

    await_true("the second submission's end", has_ended)


@contextmanager
def _ground(options: argparse.Namespace) -> Iterator[RestoreTarget]:
    with ExitStack() as stack:
        postgres = stack.enter_context(running_postgres(synchronous_commit="on")) if options.postgres else None
        if postgres is not None:
            postgres.run("CREATE DATABASE stone")
        store: StoreSettings = stack.enter_context(running_s3()).settings() if options.s3 else StoreSettings()
        settings = Settings(
            data_folder=options.folder / "data",
            workers=WORKERS,
            database=DatabaseSettings(postgres.url("stone") if postgres else ""),
            jobs=replace(JOBS, rest_s=0.2),
            store=replace(store, grace_s=STORE.grace_s),
            api=API,
            viewing=VIEWING,
        )
        yield RestoreTarget(settings, postgres)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos.restore", description=__doc__)
    parser.add_argument("--postgres", action="store_true", help="on PostgreSQL instead of SQLite")
    parser.add_argument("--s3", action="store_true", help="store objects in a bucket instead of a folder")
    parser.add_argument("--folder", type=Path, help="folder of the drill (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-restore-"))).absolute()
    return options


if __name__ == "__main__":
    sys.exit(main())
