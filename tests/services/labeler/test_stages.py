"""A sequence goes through the queues; what comes out is what the local command makes, byte for byte."""

import hashlib
import io
import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import dist
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from sqlalchemy import delete, select, update

from services.domain.sequences.processing import CHECK, PROCESS, delete_sequence
from services.ingest import stages as ingest
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import opened_sequence
from services.labeler import stages
from services.labeler.local_run import LabelOptions, label, tasks_of
from services.labeler.parameters import parameters_for
from services.labeler.pipeline import PUBLISH, STAGES, label_graph
from services.labeler.run import LabelRun
from services.labeler.workers import Task
from services.runtime.database.migrate import upgrade
from services.runtime.jobs.control import cancel
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Artefact, Job, JobAttempt, JobLine, JobNeed, LabelledFrameRow, LabelSet
from services.runtime.settings import DatabaseSettings, StoreSettings
from simulator.pipeline import calibration_path
from stone.errors import StoneError
from stone.labels.traversability import NoReferenceError
from testing.servers.fixtures import make_settings, opened
from testing.worlds.runs import (
    NAME,
    Brought,
    Interrupted,
    Said,
    bring_ready,
    differing,
    files_of_label,
    run_all,
    simulated,
)

KINDS = {"ingest.synchronise", "ingest.check"} | {
    f"labeler.{stage}"
    for stage in ("parts", "fuse", "surface", "sight", "reference", "frames", "map", "pictures", "publish")
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("field"))


@pytest.fixture(scope="module")
def expected(bag: Path) -> dict[str, bytes]:
    """What `stone label` makes of the same recording."""
    folder = bag.parent / "labels"
    with opened_sequence(bag, calibration_path(bag), NAME, SynchroniseOptions()) as opened:
        options = LabelOptions(workers=2, late_inputs=opened.recording_inputs, late_findings=opened.late_findings)
        label(opened.sequence, opened.sweeps, folder, options)
    return files_of_label(folder)


@pytest.mark.parametrize(
    "done",
    [
        pytest.param(0, id="before synchronising", marks=pytest.mark.whole),
        pytest.param(1, id="before labelling", marks=pytest.mark.whole),
        pytest.param(5, id="amid the parts", marks=pytest.mark.whole),
    ],
)
def test_a_run_that_another_version_began_is_begun_again_and_ends_as_any(
    bag: Path, expected: dict[str, bytes], tmp_path: Path, done: int
) -> None:
    """Catches alone labels half of which were made by the code before an upgrade."""
    platform = opened(make_settings(tmp_path), [])
    upgrade(platform.settings)
    brought = bring_ready(platform, bag)
    old_id = brought.process(parameters={"reference.alpha": 0.05})
    tables = {"ingest": ingest.handlers(platform), "labeler": stages.handlers(platform)}
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


class Interruptions:
    """Every kind of job is interrupted once: at its second word, else when it is done, publishing while it commits."""

    def __init__(self) -> None:
        self.kinds: set[str] = set()

    def wrap(self, kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if kind in self.kinds:
                return handler(attempt)
            self.kinds.add(kind)
            if kind == "labeler.publish":
                return replace(handler(attempt), commit=self._break)
            handler(Interrupted(attempt))
            raise RuntimeError("interrupted at the end")

        return run

    def _break(self, _session: object) -> None:
        raise RuntimeError("interrupted in the commit")


@pytest.fixture(scope="module")
def made(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Brought, str]]:
    """A run of which every stage was interrupted once, and its id; to be looked at only."""
    settings = make_settings(tmp_path_factory.mktemp("platform"))
    upgrade(settings)
    platform = opened(settings, [])
    brought = bring_ready(platform, bag)
    root_id = brought.process()
    interruptions = Interruptions()
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
def worked(bag: Path) -> tuple[LabelRun, list[Task]]:
    """The jobs of the same recording as `stone label` would hand them to its processes, done one after another."""
    with opened_sequence(bag, calibration_path(bag), NAME, SynchroniseOptions()) as opened:
        inputs = {**opened.recording_inputs(), **opened.sequence.inputs}
        findings = (*opened.sequence.findings, *opened.late_findings())
        sequence = replace(opened.sequence, inputs=inputs, findings=findings)
        run = LabelRun(sequence, opened.sweeps, parameters_for("paper"), bag.parent / "scratch")
        tasks = tasks_of(run)
        for task in tasks:
            task.call(*task.arguments)
    return run, tasks


def test_the_command_and_the_queue_run_the_same_jobs(
    made: tuple[Brought, str], worked: tuple[LabelRun, list[Task]]
) -> None:
    brought, root_id = made
    nodes = label_graph(worked[0])
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
    waits = {str(task.key[1]): {key[1] for key in task.needs} for task in worked[1]}
    assert waits == {node.key: set(node.needs) for node in nodes if node.kind != PUBLISH}


def test_the_command_and_the_queue_leave_each_other_the_same_files(
    made: tuple[Brought, str], worked: tuple[LabelRun, list[Task]]
) -> None:
    brought, root_id = made
    ours, theirs = worked[0].scratch, brought.platform.settings.root / "store" / "work" / root_id
    files = [path.relative_to(ours) for path in ours.rglob("*") if path.is_file()]
    assert {path.parts[0] for path in files} == {
        *("fused", "far", "images", "surface", "sums", "sight", "packs", "map"),
        *("reference.npz", "profiles.npz", "coverage.npz"),
    }
    assert [path for path in files if (ours / path).read_bytes() != (theirs / path).read_bytes()] == []


def test_a_job_leaves_what_it_declares_and_no_more(worked: tuple[LabelRun, list[Task]]) -> None:
    run = worked[0]
    declared = [STAGES[node.kind].files(run, node.arguments) for node in label_graph(run) if node.kind in STAGES]
    written = {path for files in declared for pattern in files.writes for path in run.scratch.glob(pattern)}
    left = {path for path in run.scratch.rglob("*") if path.is_file()}
    assert {path for path in left if not written & {path, *path.parents}} == set()
    found = [[*run.scratch.glob(f"{name}*")] for files in declared for name in files.requires]
    assert all(found), "nothing is required that nobody leaves"


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


def test_rows_say_what_was_made_and_where_it_lies(made: tuple[Brought, str]) -> None:
    brought, root_id = made
    (label_set,) = brought.label_sets()
    run = brought.job(root_id)
    assert run.result == {"label_set_id": label_set.id, "frames": label_set.frames, "recipe": label_set.recipe}
    assert (label_set.job_id, label_set.recipe) == (root_id, run.arguments["recipe"])
    assert label_set.parameters["profile"] == "paper"
    with brought.platform.database.reading() as session:
        frames = session.scalars(select(LabelledFrameRow).order_by(LabelledFrameRow.ordinal)).all()
        packs = session.scalars(select(Artefact.name).where(Artefact.name.startswith("labels/"))).all()
        lines = session.scalars(select(JobLine.event)).all()
    assert [frame.ordinal for frame in frames] == list(range(label_set.frames))
    assert [frame.stamp_ns for frame in frames] == sorted(frame.stamp_ns for frame in frames)
    assert sorted(packs) == ["labels/000000.pack", "labels/000060.pack"]
    assert {"synchronised", "fused", "reconstructed", "reference", "labelled", "stored"} <= set(lines)


def test_the_row_says_what_the_frame_table_adds_up_to(made: tuple[Brought, str], expected: dict[str, bytes]) -> None:
    brought, _root_id = made
    (label_set,) = brought.label_sets()
    rows = pq.read_table(io.BytesIO(expected["frames.parquet"])).to_pylist()
    frames = [row for row in rows if row["exclusion_code"] is None]
    for name in ("free_voxels", "t_voxels", "p_voxels", "n_voxels"):
        assert getattr(label_set, name) == sum(frame[name] for frame in frames)
    steps = [dist(*([row[axis] for axis in ("x_m", "y_m", "z_m")] for row in pair)) for pair in pairwise(frames)]
    assert label_set.distance_m == pytest.approx(sum(steps))
    assert label_set.duration_ns == pytest.approx(len(frames) * 1e8, rel=1e-3)


def test_asking_for_the_same_again_costs_nothing(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    assert brought.process() == root_id
    assert run_all(brought.platform) == 0
    assert brought.process(profile="local") != root_id


@pytest.mark.whole
def test_zombies_beside_a_finished_run_change_no_byte(finished: tuple[Brought, str]) -> None:
    """Catches alone a stage that writes once more after its run has ended."""
    brought, root_id = finished
    store = brought.platform.settings.root / "store"
    before = hashes(store)
    table = stages.handlers(brought.platform)
    chosen = ("labeler.sight", "labeler.reference", "labeler.map", "labeler.publish")
    jobs = {job.kind: job for job in brought.jobs(root_id) if job.kind in chosen}
    parts = [job for job in brought.jobs(root_id) if job.arguments.get("part", [0])[0] == 60]
    again = [*jobs.values(), *parts]
    assert len(again) == 6
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda job: table[job.kind](Said(job)), again * 2))
    after = hashes(store)
    assert {name: after[name] for name in before} == before
    assert {name.split("/")[0] for name in after.keys() - before.keys()} <= {"blobs"}


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

    def deleted_meanwhile(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            outcome = handler(attempt)
            with brought.platform.database.transaction() as session:
                delete_sequence(session, brought.sequence())
            return outcome

        return run

    assert run_all(brought.platform, wrap=deleted_meanwhile) == 1
    assert brought.label_sets() == []
    run = brought.job(root_id)
    assert (run.state, run.cancel_reason) == ("cancelled", "its sequence was deleted")
    with brought.platform.database.reading() as session:
        assert session.scalars(select(Artefact)).all() == []


def test_a_run_that_is_published_twice_has_one_label_set(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    publish_again(brought, root_id)
    assert run_all(brought.platform) == 1
    (label_set,) = brought.label_sets()
    assert brought.job(root_id).result["label_set_id"] == label_set.id  # type: ignore[index]
    with brought.platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == root_id).values(state="running"))
        session.execute(update(Job).where(Job.kind == "labeler.publish").values(state="queued"))
    assert run_all(brought.platform) == 1
    assert [row.id for row in brought.label_sets()] == [label_set.id]


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


def test_a_run_in_which_no_point_fell_anywhere_is_refused(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    work = brought.platform.settings.root / "store" / "work" / root_id
    for folder in ("fused", "surface", "sums"):
        shutil.rmtree(work / folder)
    jobs = {job.kind: job for job in brought.jobs(root_id)}
    table = stages.handlers(brought.platform)
    assert table["labeler.surface"](Said(jobs["labeler.surface"])) == Outcome({"voxels": 0})
    with pytest.raises(NoReferenceError, match="the track covers 0 surface voxels"):
        table["labeler.reference"](Said(jobs["labeler.reference"]))


def test_work_that_was_removed_and_code_that_changed_are_named(finished: tuple[Brought, str]) -> None:
    brought, root_id = finished
    table = stages.handlers(brought.platform)
    frames = next(job for job in brought.jobs(root_id) if job.kind == "labeler.frames")
    work = brought.platform.settings.root / "store" / "work" / root_id
    shutil.rmtree(work / "surface")
    with pytest.raises(StoneError, match="surface of this run is gone"):
        table[frames.kind](Said(frames))
    shutil.rmtree(work)
    with pytest.raises(StoneError, match=r"sweeps\.npz of this run is gone"):
        table[frames.kind](Said(frames))
    with brought.platform.database.transaction() as session:
        run = session.get_one(Job, root_id)
        run.arguments = {**run.arguments, "code_version": "0.0.1"}
    with pytest.raises(StoneError, match=r"begun by version 0\.0\.1"):
        table[frames.kind](Said(frames))
