"""A sequence goes through the queues; what comes out is what the local command makes, byte for byte."""

import hashlib
import io
import json
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist
from multiprocessing import get_context
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from sqlalchemy import delete, select, update

from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.domain.sequences.processing import CHECK, PROCESS, delete_sequence
from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers
from services.labeler.child_answers import FilesAnswer, WorkAnswer
from services.labeler.pipeline import STAGES, label_graph
from services.labeler.run import LabelRun
from services.labeler.run_workspace import stage_context_of
from services.labeler.sandboxed_run import RunOpening, StageTask, files_near, worked
from services.labeler.spent_files import delete_spent
from services.runtime.database.migrate import upgrade
from services.runtime.jobs.control import cancel
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Artefact, Job, JobAttempt, JobLine, JobNeed, LabelledFrameRow, LabelSet
from services.runtime.platform import Platform
from services.runtime.processes.worker import FORKED_FROM
from services.runtime.sandbox import SandboxLimits, fork_client, job_sandbox
from services.runtime.sandbox.fork_client import ForkServer
from services.runtime.sandbox.job_sandbox import CHILDREN
from services.runtime.sandbox.parent import SandboxProcess
from services.runtime.settings import DatabaseSettings, StoreSettings
from simulator.pipeline import calibration_path
from stone.errors import StoneError
from stone_base.codes.catalogue import harm_of
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.worlds.drives import SHORT, TWO_PARTS, drive, labelled_platform, labels_of_two_parts
from testing.worlds.ros1_bags import as_ros1, unclosed
from testing.worlds.runs import (
    Brought,
    Interruptions,
    Said,
    bring,
    bring_ready,
    differing,
    followed_by,
    run_all,
)

KINDS = {"ingest.synchronise", "ingest.check"} | {
    f"labeler.{stage}" for stage in ("parts", "fuse", "surface", "reference", "frames", "map", "pictures", "publish")
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, TWO_PARTS)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return labels_of_two_parts(tmp_path_factory)


@pytest.mark.whole
@pytest.mark.parametrize(
    "done",
    [pytest.param(0, id="before synchronising", marks=pytest.mark.release), pytest.param(5, id="amid the stages")],
)
def test_a_run_that_another_version_began_is_begun_again_and_ends_as_any(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, done: int
) -> None:
    """Catches alone labels half of which were made by the code before an upgrade."""
    with labelled_platform(tmp_path_factory, tmp_path / "sound") as sound:
        expected = sound.files()
    platform = opened(make_settings(tmp_path), [])
    upgrade(platform.settings)
    brought = bring_ready(platform, drive(tmp_path_factory, SHORT))
    old_id = brought.process(parameters={"reference.alpha": 0.05})
    tables = {"ingest": ingest.handlers(platform), "labeler": queue_handlers.handlers(platform)}
    for number in range(done):
        assert run_next(platform, "labeler" if number else "ingest", tables["labeler" if number else "ingest"])
    with platform.database.transaction() as session:
        run = session.get_one(Job, old_id)
        run.arguments = {**run.arguments, "code_version": "0.1.0"}
    run_all(platform)
    with platform.database.reading() as session:
        old, new = session.scalars(select(Job).where(Job.kind == PROCESS).order_by(Job.id)).all()
    assert (old.id, old.state, old.failure_code, new.state, new.failure) == (old_id, "cancelled", "", "succeeded", "")
    assert new.arguments["parameters"] == {"reference.alpha": 0.05}
    assert {job.state for job in brought.jobs(old_id)} <= {"succeeded", "cancelled"}
    assert differing(brought.files(), expected) == []
    platform.database.close()


@pytest.fixture(scope="module")
def made(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Brought, str]]:
    """A run of which every stage was interrupted once, and its id; to be looked at only."""
    settings = make_settings(tmp_path_factory.mktemp("platform"))
    upgrade(settings)
    platform = opened(settings, [])
    brought = bring_ready(platform, bag)
    root_id = brought.process()
    interruptions = Interruptions("labeler.publish")
    run_all(platform, wrap=interruptions.wrap)
    assert interruptions.kinds == KINDS
    yield brought, root_id
    platform.database.close()


@pytest.fixture
def finished(made: tuple[Brought, str], tmp_path: Path) -> Iterator[tuple[Brought, str]]:
    """A copy of that platform, to be changed."""
    brought, root_id = made
    settings = make_settings(tmp_path)
    shutil.copytree(brought.platform.settings.root, settings.root, symlinks=True)
    platform = opened(settings, [])
    yield replace(brought, platform=platform), root_id
    platform.database.close()


@pytest.mark.whole
def test_the_queue_makes_what_the_command_makes_though_every_stage_was_interrupted(
    made: tuple[Brought, str], expected: dict[str, bytes]
) -> None:
    """Catches alone a stage that leaves other bytes than the command's when it was begun twice."""
    brought, root_id = made
    run = brought.job(root_id)
    assert (run.state, run.failure) == ("succeeded", "")
    assert len(expected) > 60
    assert differing(brought.files(), expected) == []
    with brought.platform.database.reading() as session:
        lost = select(Job.kind).join(JobAttempt, Job.id == JobAttempt.job_id).where(JobAttempt.outcome == "lost")
        assert set(session.scalars(lost.where(Job.root_id == root_id))) == KINDS


@pytest.fixture(scope="module")
def run(made: tuple[Brought, str]) -> LabelRun:
    """The run as a stage opens it, in its folder with what every stage left."""
    brought, root_id = made
    return RunOpening(brought.platform.settings.root / "store" / "work" / root_id, DEFAULT_PROFILE, {}).run()


@pytest.mark.whole
def test_the_queue_runs_the_jobs_of_the_graph(made: tuple[Brought, str], run: LabelRun) -> None:
    brought, root_id = made
    nodes = label_graph(run)
    jobs = {job.id: job for job in brought.jobs(root_id) if job.kind in {node.kind for node in nodes}}
    with brought.platform.database.reading() as session:
        found = session.execute(select(JobNeed.job_id, JobNeed.needed_id).where(JobNeed.job_id.in_(jobs)))
        needs = {(job_id, needed_id) for job_id, needed_id in found}
    named = [(node.kind, json.loads(json.dumps(node.arguments))) for node in nodes]
    assert [(job.kind, job.arguments) for job in jobs.values()] == named, "in the order in which they are taken"
    of_key = {node.key: job_id for node, job_id in zip(nodes, jobs, strict=True)}
    (check,) = (job.id for job in brought.jobs(root_id) if job.kind == CHECK)
    within = {(of_key[node.key], of_key[key]) for node in nodes for key in node.needs}
    assert needs == within | {(of_key[nodes[-1].key], check)}, "and publishing waits for the checks"


@pytest.mark.whole
def test_jobs_read_the_files_that_they_declare_and_answer_with_those_that_they_wrote(
    run: LabelRun, bag: Path, tmp_path: Path
) -> None:
    """Catches alone a stage that works on one machine only, or waits for files that it does not read."""
    with ProcessPoolExecutor(1, get_context("fork")) as pool:
        jobs = pool.submit(work_apart, run.scratch, bag, tmp_path).result()
    for job in jobs:
        assert job.answered == job.written, job.kind
        assert job.read == (job.declared if job.written else set()), job.kind
    assert {job.kind for job in jobs} == set(STAGES)
    ours, theirs = ({name: hashes(at)[name] for name in names_in(at)} for at in (tmp_path / "left", run.scratch))
    spent = {name: ours.pop(name) for name in list(ours) if name.startswith(("fused/", "images/"))}
    assert spent
    assert ours == theirs, "all but what every tile has read"


GIVEN = {"sequence.npz", "sweeps.npz"}
NO_STAGES = GIVEN | {"checked.npz", "published"}


@dataclass(frozen=True)
class FileAccess:
    """The names of files in scratch: those that a job declares as read, opened, wrote, and answered with."""

    kind: str
    declared: set[str]
    read: set[str]
    written: set[str]
    answered: set[str]


def work_apart(scratch: Path, bag: Path, out: Path) -> list[FileAccess]:
    """Work on each job in a folder of its own, with the files of earlier jobs that it declares and no others."""
    opened, jobs, left = list[Path](), list[FileAccess](), out / "left"

    def note(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | Path):
            opened.append(Path(arguments[0]))

    sys.addaudithook(note)
    for number, job in enumerate(label_graph(RunOpening(scratch, DEFAULT_PROFILE, {}).run())[:-1]):
        folder, stage = out / str(number), STAGES[job.kind]
        task = StageTask(
            RunOpening(folder, DEFAULT_PROFILE, {}, bag if stage.reads_sweeps else None), job.kind, job.arguments
        )
        link(scratch, folder, GIVEN)
        near = FilesAnswer.believed(files_near(task, folder, silent)).names
        declared = {name for name in names_in(left) if name.startswith((*stage.reads, *near))}
        link(left, folder, declared)
        opened.clear()
        answer = WorkAnswer.believed(worked(task, folder, silent))
        read = {name for name in names_in(folder) if folder / name in opened}
        written = names_in(folder) - declared
        link(folder, left, written)
        jobs.append(FileAccess(job.kind, declared, read, written, set(answer.written)))
    return jobs


def names_in(folder: Path) -> set[str]:
    """Return the names of the files that stages wrote; those of an interrupted attempt are hidden."""
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("[!.]*") if path.is_file()}
    return {name for name in names if name.split("/")[0] not in NO_STAGES}


def link(source: Path, target: Path, names: set[str]) -> None:
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).hardlink_to(source / name)


def silent(_stage: str, _done: int, _total: int) -> None:
    """Progress that nothing shows."""


def test_two_machines_with_s3_and_postgres_make_the_same(
    bag: Path, expected: dict[str, bytes], s3_settings: StoreSettings, fresh_postgres_url: str, tmp_path: Path
) -> None:
    """Catches alone labels that depend on which machine, store or database a stage has."""
    groups = {"store": s3_settings, "database": DatabaseSettings(fresh_postgres_url)}
    here, there = (opened(make_settings(tmp_path / name, **groups), []) for name in ("here", "there"))
    brought = bring_ready(here, bag)
    root_id = brought.process()
    run_all(there, here)
    run = brought.job(root_id)
    assert (run.state, run.failure) == ("succeeded", "")
    assert differing(brought.files(), expected) == []
    workers = [len(list((p.settings.root / "cache" / "work" / root_id).rglob("*.npz"))) for p in (here, there)]
    assert min(workers) > 2, "both machines had a part in it"
    for platform in (here, there):
        platform.database.close()


@pytest.mark.whole
def test_rows_say_what_was_made_and_where_it_lies(made: tuple[Brought, str]) -> None:
    brought, root_id = made
    (label_set,) = brought.label_sets()
    run = brought.job(root_id)
    assert run.result == {"label_set_id": label_set.id, "frames": label_set.frames, "recipe": label_set.recipe}
    assert (label_set.job_id, label_set.recipe) == (root_id, run.arguments["recipe"])
    assert label_set.parameters["profile"] == DEFAULT_PROFILE
    with brought.platform.database.reading() as session:
        frames = session.scalars(select(LabelledFrameRow).order_by(LabelledFrameRow.ordinal)).all()
        packs = session.scalars(select(Artefact.name).where(Artefact.name.startswith("labels/"))).all()
        lines = session.scalars(select(JobLine.event)).all()
    assert [frame.ordinal for frame in frames] == list(range(label_set.frames))
    assert [frame.stamp_ns for frame in frames] == sorted(frame.stamp_ns for frame in frames)
    assert sorted(packs) == ["labels/000000.pack", "labels/000060.pack"]
    assert {"synchronised", "fused", "reconstructed", "reference", "labelled", "stored"} <= set(lines)


@pytest.mark.whole
def test_the_row_says_what_the_frame_table_adds_up_to(made: tuple[Brought, str], expected: dict[str, bytes]) -> None:
    brought, _root_id = made
    (label_set,) = brought.label_sets()
    rows = pq.read_table(io.BytesIO(expected["frames.parquet"])).to_pylist()
    frames = [row for row in rows if row["exclusion_code"] is None]
    for name in ("free_voxels", "t_voxels", "p_voxels", "n_voxels"):
        assert getattr(label_set, name) == sum(frame[name] for frame in frames)
    steps = [dist(*([row[axis] for axis in ("x_m", "y_m", "z_m")] for row in pair)) for pair in pairwise(frames)]
    assert label_set.distance_m == pytest.approx(sum(steps))
    assert label_set.duration_ns == pytest.approx(len(frames) * 5e7, rel=1e-3)
    report = json.loads(expected["report.json"])
    assert report["held_out"]["recall"] is label_set.held_out_recall is label_set.held_out_m is None, "too short"
    harms = {one["code"] for one in report["findings"] if harm_of(one["code"], one["severity"]) == "wrong"}
    assert label_set.gravest_code in harms


@pytest.mark.release
def test_zombies_beside_a_finished_run_change_no_byte(finished: tuple[Brought, str]) -> None:
    """Catches alone a stage that writes once more after its run has ended."""
    brought, root_id = finished
    store = brought.platform.settings.root / "store"
    before = hashes(store)
    table = queue_handlers.handlers(brought.platform)
    chosen = ("labeler.reference", "labeler.map", "labeler.publish")
    jobs = {job.kind: job for job in brought.jobs(root_id) if job.kind in chosen}
    parts = [job for job in brought.jobs(root_id) if job.arguments.get("part", [0])[0] == 60]
    again = [*jobs.values(), *parts]
    assert len(again) == 5
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda job: table[job.kind](Said(job)), again * 2))
    after = hashes(store)
    assert {name: after[name] for name in before} == before
    made = {
        "blobs",
        *(f"work/{root_id}/{folder}" for folder in ("fused", "images")),
    }  # again by a part; nobody reads it
    assert {name for name in after.keys() - before.keys() if not name.startswith(tuple(made))} == set()


def hashes(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def publish_again(brought: Brought, root_id: str) -> None:
    """As if the run had not been published yet."""
    with brought.platform.database.transaction() as session:
        session.execute(delete(LabelSet))
        session.execute(update(Job).where(Job.id == root_id).values(state="running", result=None))
        session.execute(update(Job).where(Job.kind == "labeler.publish").values(state="queued", attempts_left=3))


def test_a_sequence_deleted_while_its_labels_are_published_gets_none(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    publish_again(brought, root_id)
    deleted = followed_by(lambda session: delete_sequence(session, brought.sequence()), brought.platform)
    assert run_all(brought.platform, wrap=deleted) == 1
    assert brought.label_sets() == []
    run = brought.job(root_id)
    assert (run.state, run.cancel_reason) == ("cancelled", "its sequence was deleted")
    with brought.platform.database.reading() as session:
        assert session.scalars(select(Artefact)).all() == []


def test_a_stage_of_a_cancelled_run_stops_at_its_next_word(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    with brought.platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == root_id).values(state="running"))
        session.execute(update(Job).where(Job.kind == "labeler.frames").values(state="queued"))
    words = list[int]()

    def cancelled_meanwhile(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            with brought.platform.database.transaction() as session:
                cancel(session, root_id, "the field engineer changed her mind")
            attempt.log("cancelled from outside")
            return handler(Said(brought.job(attempt.job_id), words, attempt))

        return run

    run_all(brought.platform, wrap=cancelled_meanwhile)
    assert brought.job(root_id).state == "cancelled"
    assert len(words) < 60


def test_what_every_tile_has_read_is_deleted_and_nothing_that_one_still_reads(finished: tuple[Brought, str]) -> None:
    """Catches alone a tile that is begun again and finds no points of a neighbour, or no range images of a part."""
    brought, root_id = finished
    work = brought.platform.settings.root / "store" / "work" / root_id
    assert not (work / "fused").exists()
    assert not (work / "images").exists()
    jobs = brought.jobs(root_id)
    tiles = [job for job in jobs if job.kind == "labeler.surface"]
    parts = {job.id: job.arguments["part"][0] for job in jobs if job.kind == "labeler.fuse"}
    first, last = tiles[0], tiles[-1]
    with brought.platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == last.id).values(state="queued"))
        needed = session.scalars(select(JobNeed.needed_id).where(JobNeed.job_id == last.id)).all()
    left = [f"images/{start:06d}.npz" for start in parts.values()]
    left += [f"fused/{job.arguments['tile'][0]}_{job.arguments['tile'][1]}/000000.npz" for job in tiles]
    for name in left:
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        (work / name).write_bytes(b"left")
    i, j, _ = last.arguments["tile"]
    near = {f"fused/{i + x}_{j + y}/000000.npz" for x in (-1, 0, 1) for y in (-1, 0, 1)}
    attempt = Said(next(job for job in jobs if job.kind == "labeler.fuse"))
    delete_spent(stage_context_of(brought.platform, attempt))
    found = {
        path.relative_to(work).as_posix() for folder in ("fused", "images") for path in (work / folder).rglob("*.npz")
    }
    assert found == {f"images/{parts[one]:06d}.npz" for one in needed} | (near & set(left))
    assert found < set(left), f"tile {first.arguments['tile']} was far enough to be deleted"


def test_a_run_in_which_no_point_fell_anywhere_is_refused(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    work = brought.platform.settings.root / "store" / "work" / root_id
    for folder in ("surface", "sums"):
        shutil.rmtree(work / folder)
    jobs = {job.kind: job for job in brought.jobs(root_id)}
    table = queue_handlers.handlers(brought.platform)
    assert table["labeler.surface"](Said(jobs["labeler.surface"])) == Outcome({"voxels": 0})
    with refused_as("no_reference"):
        table["labeler.reference"](Said(jobs["labeler.reference"]))


def test_work_that_was_removed_and_code_that_changed_are_named(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    table = queue_handlers.handlers(brought.platform)
    frames = next(job for job in brought.jobs(root_id) if job.kind == "labeler.frames")
    work = brought.platform.settings.root / "store" / "work" / root_id
    shutil.rmtree(work / "surface")
    with pytest.raises(StoneError, match="surface of this run was deleted"):
        table[frames.kind](Said(frames))
    shutil.rmtree(work)
    with pytest.raises(StoneError, match=r"sweeps\.npz of this run was deleted"):
        table[frames.kind](Said(frames))
    with brought.platform.database.transaction() as session:
        run = session.get_one(Job, root_id)
        run.arguments = {**run.arguments, "code_version": "0.0.1"}
    with pytest.raises(StoneError, match=r"started by version 0\.0\.1"):
        table[frames.kind](Said(frames))


@pytest.fixture
def server() -> Iterator[ForkServer]:
    made = ForkServer((*FORKED_FROM["ingest"], *FORKED_FROM["labeler"]))
    yield made
    CHILDREN.close()
    made.close()


@pytest.mark.release
def test_jobs_that_share_a_child_leave_what_the_command_makes(
    bag: Path, expected: dict[str, bytes], server: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone labels that depend on what an earlier job left in the memory of its child, and a child that is kept
    for jobs that read sweeps and was not given the recording when it was begun."""
    begun, given = list[SandboxProcess](), list[SandboxLimits]()
    begin, begin_kept = SandboxProcess.__init__, job_sandbox.begun_child

    def noted(self: SandboxProcess, *of: object) -> None:
        begun.append(self)
        begin(self, *of)  # type: ignore[arg-type]

    def noted_kept(server: ForkServer, run_id: str, limits: SandboxLimits) -> job_sandbox.RunChild:
        given.append(limits)
        return begin_kept(server, run_id, limits)

    monkeypatch.setattr(SandboxProcess, "__init__", noted)
    monkeypatch.setattr(job_sandbox, "begun_child", noted_kept)
    monkeypatch.setattr(fork_client, "_SERVERS", [server])
    settings = make_settings(tmp_path)
    upgrade(settings)
    platform = opened(settings, [])
    brought = bring_ready(platform, bag)
    root_id = brought.process()
    run_all(platform)
    jobs = [job for job in brought.jobs(root_id) if job.queue]
    assert (brought.job(root_id).state, {job.attempt for job in jobs}) == ("succeeded", {1})
    assert differing(brought.files(), expected) == []
    assert len(begun) < len(jobs) / 2
    assert given
    assert all(limits.reads for limits in given)
    platform.database.close()


@pytest.mark.whole
def test_the_platform_makes_of_an_uploaded_ros1_bag_the_labels_of_the_mcap_file(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, platform: Platform
) -> None:
    """Its recorder died before it wrote the index. Catches alone a bag that is read otherwise in the sandbox, from the
    store, or by the workers than by its tests."""
    with labelled_platform(tmp_path_factory, tmp_path / "sound") as sound:
        wanted = {name: content for name, content in sound.files().items() if name.endswith("labels.npz")}
    bag = drive(tmp_path_factory, SHORT)
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    brought.add(unclosed(as_ros1(bag, tmp_path / "run.bag", "lz4"), tmp_path / "run.bag.active"))
    run_all(platform)
    assert brought.recording().state == "registered"
    run_id = brought.process()
    run_all(platform)
    assert (brought.job(run_id).state, brought.job(run_id).failure) == ("succeeded", "")
    found = {name: content for name, content in brought.files().items() if name.endswith("labels.npz")}
    assert wanted
    assert differing(found, wanted) == []
