"""Two machines on a link that is cut and slowed: `python -m chaos.machines [--cut-s 60] [--bytes-per-s 1000000]`.

One machine (a network namespace of its own) runs PostgreSQL, Redis, the S3 store, API and sweeper; the other runs the
workers with a disk of their own. After an undisturbed run, the link is cut in the middle of a second run for `--cut-s`.
In the middle of a third run it is slowed until the run is over. Each run must end with the same bytes, nothing lost,
nothing doubled. Otherwise the exit code is 1; it is 77 if namespaces are unavailable (Linux, root, iproute2).
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from sqlalchemy import func, make_url, select

from chaos.api_calls import await_jobs, await_run, begin_run, seconds_since, upload_sequence
from chaos.inputs import Inputs, simulated
from chaos.places import SCOPES
from chaos.result_hashes import OwnerRun, RunArtefacts, made_by
from chaos.spaces import Link, Space, two_machines, why_not
from chaos.verdict import Violation, judge
from services.runtime.access.tokens import issue
from services.runtime.access.users import create_user
from services.runtime.database.migrate import upgrade
from services.runtime.embedded.supervisor import environment_of
from services.runtime.orm import Job, JobAttempt
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import (
    ApiSettings,
    BrokerSettings,
    DatabaseSettings,
    JobSettings,
    Settings,
    UploadSettings,
    ViewingSettings,
)
from stone_client.api import Api
from stone_client.credentials import Server as Address
from testing.servers.postgres import running_postgres
from testing.servers.process import ServerProcess, answers, free_port
from testing.servers.redis import running_redis
from testing.servers.s3 import running_s3

SKIPPED = 77
AFTER_JOBS = 4
PATIENCE_S = 900.0
START_S = 240.0
CONSOLE = Console(highlight=False, markup=False, soft_wrap=True)


@dataclass(frozen=True)
class DeployedPlatform:
    """A platform on two machines, seen from the first."""

    platform: Platform
    url: str
    inputs: Inputs

    @contextmanager
    def owner(self, name: str) -> Iterator[Api]:
        with self.platform.database.transaction() as session:
            token = issue(session, create_user(session, name, "curator"), "machines", SCOPES, 86_400.0)
        with Api(Address(self.url, token), patience_s=PATIENCE_S) as api:
            yield api


def main() -> int:
    options = _options()
    if reason := why_not():
        CONSOLE.print(f"skipped: {reason}")
        return SKIPPED
    inputs = simulated(options.folder / "inputs")
    with two_machines() as link, deployed(link, options.folder, inputs) as there, link.ends[0].entered():
        made = made_by(there.platform, _run(there, "undisturbed", lambda: None))
        violations = [
            *_violated(there, made, "cut", lambda: _cut(link, options.cut_s)),
            *_violated(there, made, "slowed", lambda: link.slow(options.bytes_per_s)),
        ]
        link.mend()
    for violation in violations:
        CONSOLE.print(f"{violation.sort}: {violation.sentence}")
    CONSOLE.print(f"{len(violations)} violations; folder {options.folder}")
    return 1 if violations else 0


def _violated(there: DeployedPlatform, made: RunArtefacts, name: str, strike: Callable[[], None]) -> list[Violation]:
    brought = _run(there, name, strike)
    with there.platform.database.reading() as session:
        of_run = select(func.count()).select_from(JobAttempt).join(Job, Job.id == JobAttempt.job_id)
        lost = session.scalar(of_run.where(Job.root_id == brought.run_id, JobAttempt.outcome == "lost"))
    CONSOLE.print(f"  {lost} attempts were lost and repeated")
    return judge(there.platform, brought, made)


def _run(there: DeployedPlatform, name: str, strike: Callable[[], None]) -> OwnerRun:
    """Upload the recording as a new owner, strike in the middle of the run, wait for its end."""
    begun_s = time.monotonic()
    with there.owner(name) as api:
        brought = begin_run(api, upload_sequence(api, there.inputs), there.inputs)
        brought_s = seconds_since(begun_s)
        begun_s = time.monotonic()
        done = await_jobs(api, brought.run_id, AFTER_JOBS)
        strike()
        state = await_run(api, brought.run_id, PATIENCE_S)
    CONSOLE.print(f"{name}: uploaded in {brought_s}, struck after {done} jobs, {state} after {seconds_since(begun_s)}")
    return brought


def _cut(link: Link, cut_s: float) -> None:
    link.cut()
    time.sleep(cut_s)
    link.mend()


@contextmanager
def deployed(link: Link, folder: Path, inputs: Inputs) -> Iterator[DeployedPlatform]:
    """Run servers, API and sweeper on the first machine, a worker with two processes on the second."""
    first, second = link.ends
    with ExitStack() as stack:
        with first.entered():
            settings = stack.enter_context(_servers(first, folder))
            upgrade(settings)
            platform = open_platform(settings)
            stack.callback(platform.database.close)
            port = settings.api.port
            stack.enter_context(_process(settings, folder, "api", lambda: answers(port)))
            stack.enter_context(_process(settings, folder, "sweeper", lambda: True))
        with second.entered():
            elsewhere = settings.model_copy(update={"data_folder": folder / "second"})
            queues = ("ingest", "labeler", "eval")
            stack.enter_context(_process(elsewhere, folder, "worker", lambda: True, queues))
        yield DeployedPlatform(platform, settings.api.url, inputs)


@contextmanager
def _servers(space: Space, folder: Path) -> Iterator[Settings]:
    """Yield settings with which both machines reach the servers of `space`; call it within `space`."""
    rules = Path(tempfile.mkdtemp(prefix="stone-hba-")) / "hba.conf"
    rules.write_text(f"host all all {space.address}/24 trust\nhost all all 127.0.0.1/32 trust\n")
    rules.parent.chmod(0o755)
    with ExitStack() as stack:
        listens = {"listen_addresses": "*", "hba_file": str(rules)}
        postgres = stack.enter_context(running_postgres(synchronous_commit="on", **listens))
        redis = stack.enter_context(running_redis(space.address))
        s3 = stack.enter_context(running_s3(space.address))
        port = free_port()
        yield Settings(
            data_folder=folder / "first",
            workers=2,
            database=DatabaseSettings(_at(postgres.url(), space)),
            store=s3.settings("machines"),
            broker=BrokerSettings(redis.url),
            jobs=JobSettings(),
            uploads=replace(UploadSettings(), backend="store"),
            api=ApiSettings(host="127.0.0.1", port=port, url=f"http://127.0.0.1:{port}", pages=False),
            viewing=ViewingSettings(makes_playback=False),
        )


def _at(url: str, space: Space) -> str:
    return make_url(url).set(host=space.address).render_as_string(hide_password=False)


MODULES: Mapping[str, str] = {
    "api": "services.runtime.processes.api",
    "worker": "services.runtime.processes.worker",
    "sweeper": "services.maintenance.sweeper",
}


@contextmanager
def _process(
    settings: Settings, folder: Path, role: str, is_ready: Callable[[], bool], words: tuple[str, ...] = ()
) -> Iterator[None]:
    """Run a process of the platform on the machine of this thread; its log is `<folder>/<role>/log`."""
    logs = folder / role
    logs.mkdir(parents=True)
    command = [sys.executable, "-P", "-m", MODULES[role], *words]
    server = ServerProcess(command, logs, is_ready, environment=environment_of(settings), patience_s=START_S)
    server.start()
    try:
        yield
    finally:
        server.stop()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m chaos.machines", description=__doc__)
    parser.add_argument("--cut-s", type=float, default=60.0)
    parser.add_argument("--bytes-per-s", type=int, default=10**6)
    parser.add_argument("--folder", type=Path, help="folder of the drill (default: a temporary folder)")
    options = parser.parse_args()
    options.folder = (options.folder or Path(tempfile.mkdtemp(prefix="stone-machines-"))).absolute()
    return options


if __name__ == "__main__":
    sys.exit(main())
