"""A worker is killed with −9 at moments of an import: nothing is lost, nothing is there twice, no byte differs.

Six moments of an uploaded tar, twenty of the released twin's ZIP in place; a check tries every `SPARSE`-th statement of
them. Catches alone an import whose stages leave half a scene, or rows of one that was done before, when their process
ends at any statement or while a child works; before a release, by 28 imports, 75 s of processor time.
"""

import os
import shutil
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import event, select

from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labeler
from services.runtime.database.transactions import Database
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.lease_sweep import CRASHED, give_back_running
from services.runtime.orm import JobAttempt
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.factory import open_store
from stone_recordings.sync.stored_recording import RecordingPlace
from testing.process_states import children_of, is_running
from testing.servers.fixtures import make_settings, opened
from testing.worlds.brought_datasets import (
    BroughtDataset,
    an_owner,
    bring_dataset,
    counts_of,
    files_of,
    place_dataset,
)
from testing.worlds.placed import in_folder
from testing.worlds.published_datasets import SyntheticDataset, made_labels, write_published_tar
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from testing.worlds.runs import run_all

pytestmark = pytest.mark.whole

PATIENCE_S = 300.0
SMALL = SyntheticDataset(scenes=2, frames=2, cameras=("CAM_FRONT",), radars=(), labels=(made_labels(0), made_labels(1)))
RELEASED = ReleasedDataset(scenes=2, frames=1)
CHILDREN = 2
STATEMENTS = {"tar": 4, "zip": 18}
KINDS = list(STATEMENTS)
SPARSE = 5
MOMENTS = [
    pytest.param(kind, moment, marks=pytest.mark.release if moment % SPARSE else ())
    for kind, moments in STATEMENTS.items()
    for moment in range(moments)
]


@dataclass(frozen=True, eq=False)
class Undisturbed:
    """A platform on which a dataset waits to be imported, and what an import that nobody disturbs makes of it.

    `root` is the folder of a dataset in place.
    """

    folder: Path
    root: Path | None
    import_id: str
    owner_id: str
    statements: int
    files: dict[str, bytes]
    counts: dict[str, int]

    def waiting(self, folder: Path) -> BroughtDataset:
        """A copy of the platform, to be disturbed."""
        settings = make_settings(folder)
        shutil.copytree(self.folder, settings.root)
        return BroughtDataset(with_root(opened(settings, []), self.root), self.owner_id, self.import_id)


def with_root(platform: Platform, root: Path | None) -> Platform:
    return platform if root is None else in_folder(platform, root)


@pytest.fixture(scope="module")
def all_undisturbed(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> dict[str, Undisturbed]:
    """Of each kind; tests of both come in any order."""
    return {kind: made_undisturbed(tmp_path_factory.mktemp(kind), kind, _sqlite_template) for kind in KINDS}


@pytest.fixture(params=KINDS)
def undisturbed(request: pytest.FixtureRequest, all_undisturbed: dict[str, Undisturbed]) -> Undisturbed:
    return all_undisturbed[request.param]


def made_undisturbed(folder: Path, kind: str, template: Path) -> Undisturbed:
    root = folder / "nas" if kind == "zip" else None
    settings = make_settings(folder)
    settings.root.mkdir(parents=True)
    shutil.copyfile(template, settings.root / "stone.sqlite3")
    platform = with_root(opened(settings, []), root)
    owner_id = an_owner(platform)
    if root is None:
        brought = bring_dataset(platform, write_published_tar(folder / "field.tar", SMALL), owner_id)
    else:
        root.mkdir()
        write_released_zip(root / "STONE.zip", RELEASED)
        brought = place_dataset(platform, RecordingPlace("nas", "STONE.zip"), owner_id)
    platform.database.close()
    waiting = shutil.copytree(settings.root, folder / "waiting")
    counted = _Counter(None)
    platform = with_root(opened(settings, []), root)
    event.listen(platform.database.engine, "before_cursor_execute", counted)
    run_all(platform)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    made = (files_of(platform, owner_id), counts_of(platform, owner_id))
    platform.database.close()
    return Undisturbed(waiting, root, brought.import_id, owner_id, counted.statements, *made)


@dataclass
class _Counter:
    """Counts statements, but those of heartbeats, which are as many as it takes seconds; at the one of number `last`
    its process is killed."""

    last: int | None
    statements: int = 0

    def __call__(self, *_: object) -> None:
        self.statements += threading.current_thread() is threading.main_thread()
        if self.statements == self.last:
            os.kill(os.getpid(), signal.SIGKILL)


def started(settings: Settings, last: int | None = None) -> int:
    """The pid of a worker of both queues, with connections of its own, that works until nothing is left or it is
    killed."""
    pid = os.fork()
    if pid == 0:
        try:
            own = Platform(settings, Database(settings), open_store(settings))
            event.listen(own.database.engine, "before_cursor_execute", _Counter(last))
            tables = {"ingest": ingest.handlers(own), "labeler": labeler.handlers(own)}
            while any([run_next(own, queue, handlers) for queue, handlers in tables.items()]):
                pass
        finally:
            os._exit(0)
    return pid


def until(claim: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not claim():
        assert time.monotonic() < deadline, f"never came: {what}"
        time.sleep(0.01)


def ends_as_undisturbed(brought: BroughtDataset, undisturbed: Undisturbed) -> None:
    """What the supervisor does when it has seen its worker end; then another works to the end."""
    platform = brought.platform
    give_back_running(platform, CRASHED, is_counted=True)
    run_all(platform)
    assert (brought.run().state, brought.run().failure) == ("succeeded", "")
    assert files_of(platform, brought.owner_id) == undisturbed.files
    assert counts_of(platform, brought.owner_id) == undisturbed.counts
    with platform.database.reading() as session:
        tries = session.execute(select(JobAttempt.job_id, JobAttempt.outcome)).all()
    succeeded = [job_id for job_id, outcome in tries if outcome == "succeeded"]
    assert len(succeeded) == len(set(succeeded)) == len(brought.jobs()) - 1, "each job has succeeded once"
    platform.database.close()


@pytest.mark.parametrize(("undisturbed", "moment"), MOMENTS, indirect=["undisturbed"])
def test_killed_at_a_statement_it_ends_as_if_nothing_had_been(
    undisturbed: Undisturbed, tmp_path: Path, moment: int
) -> None:
    brought = undisturbed.waiting(tmp_path)
    moments = STATEMENTS["tar" if undisturbed.root is None else "zip"]
    last = 1 + (undisturbed.statements - 1) * moment // moments
    _, status = os.waitpid(started(brought.platform.settings, last), 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    ends_as_undisturbed(brought, undisturbed)


@pytest.mark.parametrize("number", range(CHILDREN))
def test_killed_while_a_child_works_it_ends_as_if_nothing_had_been(
    undisturbed: Undisturbed, tmp_path: Path, number: int
) -> None:
    """The child of the index, or of a scene."""
    brought, seen = undisturbed.waiting(tmp_path), set[int]()
    worker = started(brought.platform.settings)

    def has_begun() -> bool:
        seen.update(children_of(worker))
        return len(seen) > number

    until(has_begun, "the worker confines its reader")
    os.kill(worker, signal.SIGKILL)
    os.waitpid(worker, 0)
    until(lambda: not any(map(is_running, seen)), "the child ends with its worker")
    ends_as_undisturbed(brought, undisturbed)
