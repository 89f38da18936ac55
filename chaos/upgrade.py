"""An upgrade drill: the previous release is stopped during work, and this release continues: `python -m chaos.upgrade`.

`[--previous COMMIT] [--postgres] [--kill] [--folder DIR]`. The sources of COMMIT serve a platform (`stone serve`, with
its pages off) that labels a recording and has received half of a file. In the middle of the run it is drained, or
killed with `--kill`. Then this checkout's `stone serve` starts on the same folder and database, and migrates it if
COMMIT has an earlier revision.

Afterwards every row must still exist, and the file must continue at its offset. The run must end with the bytes of an
undisturbed run of this release. If the code of labels changed, the platform starts a run in its place, which must end
with these bytes. The default COMMIT has the schema of the first release and other code versions. On a failure the exit
code is 1.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from sqlalchemy import MetaData, create_engine, make_url, select

from chaos.api_calls import (
    await_jobs,
    await_run,
    begin_run,
    offset_of,
    run_in_place_of,
    seconds_since,
    send_half,
    send_rest,
    upload_sequence,
)
from chaos.inputs import Inputs, simulated
from chaos.result_hashes import OwnerRun, RunArtefacts, made_by
from chaos.verdict import Violation, judge
from services.runtime.platform import open_platform
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.postgres import running_postgres
from testing.stone_serve import RESERVE, serving

ROOT = Path(__file__).resolve().parents[1]
PREVIOUS = "4fe94cb7"
PROFILE = "paper"  # a restarted run keeps the profile of its request, and the default has changed
STONE = (sys.executable, "-P", "-m", "stone_client.main")
AFTER_JOBS = 6
FAST = {
    "STONE_API__PAGES": "false",
    "STONE_VIEWING__MAKES_PLAYBACK": "false",
    "STONE_JOBS__LEASE_S": "3",
    "STONE_JOBS__HEARTBEAT_S": "0.5",
}
# Rows of processes, and of unfinished transfers, end with these.
PASSING = {"workers", "loose_objects", "score_parts", "alembic_version", "sqlite_stat1", "idempotent_replies"}
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)

Keys = Mapping[str, set[tuple[object, ...]]]


def main() -> int:
    options = _options()
    previous, inputs = sources(options.previous, options.folder / "previous"), simulated(options.folder / "inputs")
    made = undisturbed(options.folder / "undisturbed", inputs)
    CONSOLE.print(f"undisturbed, this release makes {len(made.artefacts)} artefacts, {len(made.frames)} frames")
    with _database(options.postgres) as url:
        violations = drill(Drill(options.folder / "drill", url, previous, inputs, made, is_killed=options.kill))
    for violation in violations:
        CONSOLE.print(f"{violation.sort}: {violation.sentence}")
    CONSOLE.print(f"{len(violations)} violations; folder {options.folder}")
    return 1 if violations else 0


class Drill:
    """The folders, the previous sources, and the expected results."""

    def __init__(
        self, folder: Path, url: str, previous: Path, inputs: Inputs, made: RunArtefacts, *, is_killed: bool
    ) -> None:
        self.data, self.url, self.previous = folder / "data", url, previous
        self.inputs, self.made, self.is_killed = inputs, made, is_killed
        self.environment = {**FAST, "STONE_DATABASE__URL": url}
        self.data.mkdir(parents=True)

    @property
    def settings(self) -> Settings:
        return Settings(data_folder=self.data, database=DatabaseSettings(self.url))


def drill(drill: Drill) -> list[Violation]:
    """Return everything lost, doubled or different."""
    # Until 30 November 2026 releases refused this setting as unknown, and kept no reserve.
    before_it = {**drill.environment, "PYTHONPATH": str(drill.previous), RESERVE: None}
    with serving(drill.data, STONE, **before_it) as old, old.api() as api:
        half = send_half(api)
        brought = begin_run(api, upload_sequence(api, drill.inputs), drill.inputs, profile=PROFILE)
        done = await_jobs(api, brought.run_id, AFTER_JOBS)
        begun_s = time.monotonic()
        if drill.is_killed:
            old.kill_9()
        else:
            old.stop()
    before = keys_of(drill.settings)
    CONSOLE.print(f"the previous release ended after {done} jobs, in {seconds_since(begun_s)}; {_counted(before)}")
    violations: list[Violation] = []
    begun_s = time.monotonic()
    with serving(drill.data, STONE, **drill.environment, PYTHONPATH=str(ROOT)) as new, new.api() as api:
        CONSOLE.print(f"this release responds after {seconds_since(begun_s)}")
        if (offset := offset_of(api, half)) == 0:
            violations.append(Violation("lost", "the half-sent file has no bytes left"))
        state = await_run(api, brought.run_id)
        if newer_id := run_in_place_of(api, brought):
            CONSOLE.print(f"the run is {state} after {seconds_since(begun_s)}, and started again")
            brought = replace(brought, run_id=newer_id, replaced_id=brought.run_id)
            state = await_run(api, newer_id)
        CONSOLE.print(f"the run is {state} after {seconds_since(begun_s)}; the file continues at byte {offset}")
        if (state := send_rest(api, half)) != "complete":
            violations.append(Violation("lost", f"the half-sent file is {state}"))
    return [*violations, *_lost(before, keys_of(drill.settings)), *_judged(drill, brought)]


def undisturbed(folder: Path, inputs: Inputs) -> RunArtefacts:
    """Return the results of this release for the recording."""
    data = folder / "data"
    data.mkdir(parents=True)
    with serving(data, STONE, **FAST, PYTHONPATH=str(ROOT)) as new, new.api() as api:
        brought = begin_run(api, upload_sequence(api, inputs), inputs, profile=PROFILE)
        await_run(api, brought.run_id)
    platform = open_platform(Settings(data_folder=data))
    try:
        return made_by(platform, brought)
    finally:
        platform.database.close()


def sources(commit: str, folder: Path) -> Path:
    """Return the packages of the commit."""
    folder.mkdir(parents=True)
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    return folder


def keys_of(settings: Settings) -> Keys:
    """Return the primary keys of all rows, for tables of any release."""
    url = make_url(settings.database_url)
    engine = create_engine(url if url.get_backend_name() == "sqlite" else url.set(drivername="postgresql+psycopg"))
    metadata = MetaData()
    metadata.reflect(engine)
    with engine.connect() as connection:
        tables = [table for table in metadata.sorted_tables if table.name not in PASSING]
        keys = {table.name: {tuple(row) for row in connection.execute(select(*table.primary_key))} for table in tables}
    engine.dispose()
    return keys


def _lost(before: Keys, after: Keys) -> Iterator[Violation]:
    for table, keys in before.items():
        gone = keys - after.get(table, set())
        if gone:
            yield Violation("lost", f"{len(gone)} of {len(keys)} rows of {table}, among them {min(gone, key=str)}")


def _judged(drill: Drill, brought: OwnerRun) -> list[Violation]:
    """Judge the run as the kill suite does, ignoring the half-sent file, which is no recording of it."""
    platform = open_platform(drill.settings)
    try:
        violations = judge(platform, brought, drill.made)
    finally:
        platform.database.close()
    return [violation for violation in violations if not _is_of_half(violation)]


def _is_of_half(violation: Violation) -> bool:
    return "beside the used upload" in violation.sentence


def _counted(keys: Keys) -> str:
    return f"{sum(map(len, keys.values()))} rows in {sum(map(bool, keys.values()))} tables"


@contextmanager
def _database(is_postgres: bool) -> Iterator[str]:
    if not is_postgres:
        yield ""
        return
    with running_postgres(synchronous_commit="on") as server:
        yield server.url()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos.upgrade", description=__doc__)
    parser.add_argument("--previous", default=PREVIOUS, help="commit of the previous release")
    parser.add_argument("--postgres", action="store_true", help="on PostgreSQL instead of SQLite")
    parser.add_argument("--kill", action="store_true", help="kill −9 the previous release instead of draining it")
    parser.add_argument("--folder", type=Path, help="folder of the drill (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-upgrade-"))).absolute()
    return options


if __name__ == "__main__":
    sys.exit(main())
