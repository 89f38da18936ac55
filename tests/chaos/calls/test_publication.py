"""If any system call of a publication fails, the label set exists with all its files, or not at all."""

from dataclasses import replace
from hashlib import sha256
from typing import Any

from sqlalchemy import select

from services.labeler.child_answers import PackAnswer, PublicationAnswer, TotalsAnswer
from services.labeler.publication import NEEDED, publish
from services.labeler.publication_files import PUBLISHED
from services.labeler.run_workspace import LabelStageContext
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.lease_sweep import STOPPED, give_back_running
from services.runtime.jobs.specs import Attempt, Context, JobSpec, Outcome
from services.runtime.orm import Artefact, Blob, Job, LabelSet, SequenceRow
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.blobs import collect_garbage
from services.runtime.store.workspace import Workspace
from testing.failing_calls import Disturbed, Fault
from testing.servers.fixtures import opened
from tests.chaos.calls.every_call import FAULTS, each_call
from tests.services.runtime.jobs.steps import an_owner

PACK = b"labels of one frame"
ARGUMENTS = {"recipe": "ab" * 32, "profile": "paper", "parameters": {}, "grid": None}
ANSWER = PublicationAnswer(
    tokens=["0" * 32],
    stamps_ns=[1],
    packs=[PackAnswer(name="packs/000000.pack", first=0, ranges=[(0, len(PACK), sha256(PACK).hexdigest())])],
    totals=TotalsAnswer(duration_ns=1, distance_m=1.0, free_voxels=1, t_voxels=1, p_voxels=1, n_voxels=1),
)
FILES = ("report.json", "frames.parquet", "grid.json")


class AnsweredContext(LabelStageContext):
    """A context whose child has left its files and returns the same answer each time."""

    def ask(self, *_: object) -> Any:
        return ANSWER


def publish_run(platform: Platform) -> None:
    """Run the publication stage, as the queue does in a worker."""

    def stage(attempt: Attempt) -> Outcome:
        workspace = Workspace(platform.store, platform.settings, attempt.root_id)
        return publish(AnsweredContext(platform, attempt, dict(ARGUMENTS), workspace))

    run_next(platform, "labeler", {"labeler.publish": stage})


def lay_run(platform: Platform) -> str:
    """Create a run before its last stage, with the files of the earlier stages; return its id."""
    owner = an_owner(platform)
    with platform.database.transaction() as session:
        sequence = SequenceRow(owner_id=owner, name="forest")
        session.add(sequence)
        session.flush()
        context = Context(owner, sequence.id)
        run = enqueue_run(session, "sequence.process", [JobSpec("labeler.publish")], context)
        run.arguments = ARGUMENTS
        run_id = run.id
    folder = Workspace(platform.store, platform.settings, run_id).folder
    for name in NEEDED:
        path = folder / name
        if "." in name:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(name.encode())
        else:
            path.mkdir(parents=True)
    (folder / "packs" / "000000.pack").write_bytes(PACK)
    (folder / "map" / "bev.png").write_bytes(b"a picture")
    (folder / PUBLISHED).mkdir()
    for name in FILES:
        (folder / PUBLISHED / name).write_bytes(f"the {name}".encode())
    return run_id


def published(platform: Platform) -> dict[str, bytes]:
    """Return the files of the label set by name, each checked against its row."""
    found = {}
    with platform.database.reading() as session:
        rows = session.execute(select(Artefact.name, Blob).join(Blob, Blob.sha256 == Artefact.blob_sha256)).all()
    for name, blob in rows:
        found[name] = b"".join(platform.store.read(blob.object_key))
        assert sha256(found[name]).hexdigest() == blob.sha256
    return found


def label_sets(platform: Platform) -> int:
    with platform.database.reading() as session:
        return len(session.scalars(select(LabelSet.id)).all())


@FAULTS
def test_a_label_set_is_published_whole_or_not_at_all(settings: Settings, fault: Fault, step: int) -> None:
    platform = opened(settings, [])
    run_id = lay_run(platform)
    platform.database.close()

    def check(platform: Platform, disturbed: Disturbed) -> None:
        whole = {"report.json", "frames.parquet", "grid.json", "sequence.npz", "bev.png", "labels/000000.pack"}
        before = label_sets(platform)
        assert set(published(platform)) == (whole if before else set()), f"at {disturbed.hit}"
        give_back_running(platform, STOPPED, is_counted=False)
        publish_run(platform)
        with platform.database.reading() as session:
            run = session.get_one(Job, run_id)
        assert run.state == "succeeded", f"{run.failure} after {disturbed.hit}: {disturbed.raised}"
        assert label_sets(platform) == 1
        files = published(platform)
        assert set(files) == whole
        assert files["labels/000000.pack"] == PACK
        assert_nothing_is_left_over(platform)

    assert each_call(settings, publish_run, check, fault, step) > 30


def assert_nothing_is_left_over(platform: Platform) -> None:
    """Assert that garbage collection keeps only the objects of blobs."""
    store = replace(platform.settings.store, grace_s=0.0)
    collect_garbage(replace(platform, settings=platform.settings.model_copy(update={"store": store})))
    with platform.database.reading() as session:
        named = set(session.scalars(select(Blob.object_key)))
    root = platform.settings.root / "store"
    assert {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()} == named
