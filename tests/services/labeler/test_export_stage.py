"""An export goes through the queue: its files are what the exporter writes, there once, all or none; labels that are
published are followed by their playback: once, and never in their way.

Catches alone an export of a job that is cut off anywhere: halves, a second one, bytes that nobody counts; and a
playback that is made twice, or that holds up or spoils the labels it follows.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest
from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from services.domain.exports.requests import EXPORT, FORMATS, delete_export, start_export
from services.domain.sequences.recordings import remove_recording
from services.domain.viewer.playback import playback_of, shown_by
from services.labeler.export_stage import located_inputs, located_recording
from services.labeler.exports.registry import EXPORTERS, exporter_of
from services.labeler.queue_handlers import handlers
from services.runtime.access import storage_quota
from services.runtime.code_version import code_version
from services.runtime.jobs.control import cancel, set_mode
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.lease_sweep import CRASHED, give_back_running
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Artefact, Blob, Export, ExportPack, Job, Recording
from services.runtime.platform import Platform
from services.runtime.settings import Settings, UploadSettings, ViewingSettings
from testing.refusals import refused_as
from testing.servers.fixtures import opened
from testing.stone_serve import until
from testing.worlds.decay import decay
from testing.worlds.drives import exported_files, labelled_platform
from testing.worlds.runs import Brought, Listening, Said, followed_by, run_all
from tests.services.labeler.test_stages import publish_again

pytestmark = pytest.mark.whole

FORM = "nuscenes"


@pytest.fixture
def brought(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Iterator[Brought]:
    """A platform of the test's own with a labelled sequence."""
    with labelled_platform(tmp_path_factory, tmp_path / "platform") as brought:
        yield brought


def asked(brought: Brought, form: str = FORM) -> tuple[str, str]:
    """The export asked for, and its job, by ids."""
    with brought.platform.database.transaction() as session:
        export, job = start_export(session, brought.sequence(), form)
        return export.id, job.id


def row(platform: Platform, export_id: str) -> Export | None:
    with platform.database.reading() as session:
        return session.get(Export, export_id)


def written_directly(brought: Brought, form: str, out: Path) -> dict[str, bytes]:
    """What the exporter writes into a folder when it is called by itself."""
    (label_set,) = brought.label_sets()
    out.mkdir(parents=True)
    exporter = exporter_of(form)
    inputs = located_inputs(brought.platform, label_set.id, out.with_name("inputs"), exporter)
    bag = located_recording(brought.platform, brought.sequence_id, inputs.sequence().inputs.values())
    exporter(replace(inputs, recording=bag).opened(), out, lambda done, total: None)
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()}


def leftovers(platform: Platform, job_id: str) -> list[str]:
    work = platform.settings.root / "store" / "work" / job_id
    return sorted(path.name for path in work.iterdir()) if work.exists() else []


def test_every_format_can_be_asked_for_by_the_name_the_exporters_have() -> None:
    assert set(FORMATS) == set(EXPORTERS)


def test_an_export_has_every_file_the_exporter_writes_and_their_checksums(brought: Brought, tmp_path: Path) -> None:
    export_id, job_id = asked(brought)
    assert run_all(brought.platform) == 1
    assert brought.job(job_id).state == "succeeded", brought.job(job_id).failure
    files = exported_files(brought.platform, export_id)
    sums = files.pop("sha256sum.txt").decode().splitlines()
    assert [line.split("  ")[1] for line in sums] == sorted(files)
    assert files == written_directly(brought, FORM, tmp_path / "direct" / "out")
    export = row(brought.platform, export_id)
    assert export is not None
    assert (export.files, brought.job(job_id).result["files"]) == (len(files) + 1,) * 2  # type: ignore[index]
    assert asked(brought) == (export_id, job_id)
    assert run_all(brought.platform) == 0


def test_labels_that_decayed_are_not_exported_under_a_hash_of_their_own(brought: Brought) -> None:
    (label_set,) = brought.label_sets()
    with brought.platform.database.reading() as session:
        of_meshes = select(Blob.object_key).join(Artefact, Artefact.blob_sha256 == Blob.sha256)
        of_set = of_meshes.where(Artefact.label_set_id == label_set.id, Artefact.name == "mesh.ply")
        decay(brought.platform, session.scalars(of_set).one())
    export_id, job_id = asked(brought, "mesh")
    run_all(brought.platform)
    assert (brought.job(job_id).state, brought.job(job_id).failure_code) == ("failed", "object_damaged")
    export = row(brought.platform, export_id)
    assert export is None or export.finished_ns is None


def test_exports_of_two_versions_under_way_are_both_written(brought: Brought) -> None:
    before_id, _ = asked(brought, "mesh")
    of_another_version(brought.platform, before_id)
    after_id, after_job_id = asked(brought, "mesh")
    assert run_all(brought.platform) == 2
    before, after = row(brought.platform, before_id), row(brought.platform, after_id)
    assert before is not None
    assert after is not None
    assert (before.code_version, before.recipe) == (code_version("exports"), "0" * 64)
    assert (after.code_version, after.tar_sha256) == (code_version("exports"), before.tar_sha256)
    assert asked(brought, "mesh") == (after_id, after_job_id)


def of_another_version(platform: Platform, export_id: str) -> None:
    with platform.database.transaction() as session:
        export = session.get_one(Export, export_id)
        export.code_version, export.recipe = "0.1.0", "0" * 64


def test_attempts_that_die_anywhere_leave_one_export_and_no_halves(brought: Brought) -> None:
    export_id, job_id = asked(brought)
    deaths = iter((3, 40, 10**6))

    def dying(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            left = next(deaths, None)
            if left is None:
                return handler(attempt)
            if left == 10**6:
                outcome = handler(attempt)
                return replace(outcome, commit=partial(broken, outcome))
            return handler(Mortal(brought.job(attempt.job_id), heard_by=attempt, left=left))

        return run

    assert run_all(brought.platform, wrap=dying) == 3
    # the third try, which broke in its commit, was the last one there was
    assert brought.job(job_id).state == "failed"
    with brought.platform.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(ExportPack)) == 0
        assert session.scalar(select(Blob.sha256).join(ExportPack, ExportPack.blob_sha256 == Blob.sha256)) is None
    again = asked(brought)
    assert (again[0], again[1] != job_id) == (export_id, True)
    assert run_all(brought.platform) == 1
    assert brought.job(again[1]).state == "succeeded"
    assert len(leftovers(brought.platform, again[1])) == 1


def broken(outcome: Outcome, session: Session) -> None:
    outcome.commit(session)
    raise RuntimeError("interrupted in the commit")


@dataclass
class Mortal(Said):
    """An attempt that is over after so many words."""

    left: int = 0

    def progress(self, stage: str, done: int, total: int) -> None:
        if len(self.words) >= self.left:
            raise RuntimeError("interrupted in the middle")
        self.words.append(done)


def test_an_export_survives_kill_9(brought: Brought, tmp_path: Path) -> None:
    """A worker is killed while some files are in packs and some are not; the next one begins anew and is alone."""
    export_id, job_id = asked(brought)
    half = tmp_path / "half"
    worker = get_context("fork").Process(target=work_until, args=(brought.platform.settings, half))
    worker.start()
    until(half.exists)
    worker.kill()
    worker.join()
    killed = leftovers(brought.platform, job_id)
    assert give_back_running(brought.platform, CRASHED, is_counted=True) == 1
    assert run_all(brought.platform) == 1
    assert brought.job(job_id).state == "succeeded"
    assert set(leftovers(brought.platform, job_id)).isdisjoint(killed)
    assert exported_files(brought.platform, export_id).keys() > {"sha256sum.txt"}


def work_until(settings: Settings, half: Path) -> None:
    """Work on the next job, and say by the file `half` that it is in the middle; then wait to be killed."""
    platform = opened(settings, [])

    def pause(attempt: Attempt) -> Outcome:
        with platform.database.reading() as session:
            return handlers(platform)[EXPORT](Pausing(session.get_one(Job, attempt.job_id), half=half))

    run_next(platform, "labeler", {EXPORT: pause})


@dataclass
class Pausing(Said):
    """An attempt that stays where some files are in packs."""

    half: Path = Path()

    def progress(self, stage: str, done: int, total: int) -> None:
        if stage == "pack" and done == total // 2:
            self.half.touch()
            time.sleep(60)


def test_a_cancelled_export_stops_at_its_next_word_and_leaves_nothing(brought: Brought) -> None:
    export_id, job_id = asked(brought)

    def cancelled_meanwhile(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            with brought.platform.database.transaction() as session:
                cancel(session, job_id, "the field engineer changed her mind")
            return handler(Listening(brought.job(job_id), heard_by=attempt))

        return run

    run_all(brought.platform, wrap=cancelled_meanwhile)
    assert (brought.job(job_id).state, leftovers(brought.platform, job_id)) == ("cancelled", [])
    export = row(brought.platform, export_id)
    assert export is not None
    assert export.finished_ns is None


def test_an_export_deleted_while_it_is_written_gets_no_row(brought: Brought) -> None:
    export_id, job_id = asked(brought, "mesh")

    def deleted(session: Session) -> None:
        delete_export(session, session.get_one(Export, export_id))

    run_all(brought.platform, wrap=followed_by(deleted, brought.platform))
    assert (row(brought.platform, export_id), brought.job(job_id).state) == (None, "cancelled")
    with brought.platform.database.reading() as session:
        assert session.scalar(select(func.count()).select_from(ExportPack)) == 0


def test_an_export_beyond_the_owners_bytes_is_refused_and_takes_none(brought: Brought) -> None:
    with brought.platform.database.reading() as session:
        before = storage_quota.balance(session, brought.owner_id)
    bounded = brought.platform.settings.model_copy(update={"uploads": UploadSettings(owner_bytes=before + 100)})
    export_id, job_id = asked(brought, "mesh")
    run_all(Platform(bounded, brought.platform.database, brought.platform.store))
    job = brought.job(job_id)
    assert (job.state, job.failure_code) == ("failed", "quota_exceeded")
    with brought.platform.database.reading() as session:
        assert storage_quota.balance(session, brought.owner_id) == before
        assert session.get_one(Export, export_id).finished_ns is None


def test_a_recording_stays_while_an_export_reads_it_and_afterwards_need_not(brought: Brought) -> None:
    _, job_id = asked(brought)
    with refused_as("recording_in_use", match=job_id), brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[0]))
    run_all(brought.platform)
    with brought.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, brought.recording_ids[0]))
    _, mesh_job = asked(brought, "mesh")
    run_all(brought.platform)
    assert brought.job(mesh_job).state == "succeeded", "a mesh is made of labels alone"


def test_labels_that_are_not_what_they_were_fail_the_export(brought: Brought, tmp_path: Path) -> None:
    """Packs are compared with their sha256 before an export hashes what is made of them."""
    (label_set,) = brought.label_sets()
    of_labels = (Artefact.label_set_id == label_set.id, Artefact.name.startswith("labels/"))
    with brought.platform.database.reading() as session:
        pack = session.scalars(select(Blob).join(Artefact, Artefact.blob_sha256 == Blob.sha256).where(*of_labels)).one()
    path = brought.platform.store.local(pack.object_key)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.unlink()
    path.write_bytes(content)
    _, job_id = asked(brought)
    run_all(brought.platform)
    assert (brought.job(job_id).state, brought.job(job_id).failure_code) == ("failed", "object_damaged")


@pytest.fixture
def unpublished(brought: Brought) -> tuple[Brought, str]:
    """A platform that makes playbacks, about to publish labels; the run that does."""
    settings = brought.platform.settings.model_copy(update={"viewing": ViewingSettings(makes_playback=True)})
    platform = replace(brought.platform, settings=settings)
    (label_set,) = brought.label_sets()
    publish_again(brought, label_set.job_id)
    return replace(brought, platform=platform), label_set.job_id


def exports_of(brought: Brought) -> list[Export]:
    with brought.platform.database.reading() as session:
        return list(session.scalars(select(Export)))


def test_published_labels_are_followed_by_their_playback_as_a_job_of_its_own(
    unpublished: tuple[Brought, str],
) -> None:
    brought, run_id = unpublished
    assert run_all(brought.platform) == 2
    (label_set,), (export,) = brought.label_sets(), exports_of(brought)
    job = brought.job(export.job_id)
    assert (export.format, export.label_set_id, export.sequence_id) == ("playback", label_set.id, brought.sequence_id)
    assert (job.state, job.failure, job.root_id, job.priority) == ("succeeded", "", job.id, -1)
    assert (job.owner_id, brought.job(run_id).state) == (brought.owner_id, "succeeded")
    with brought.platform.database.reading() as session:
        playback = playback_of(session, label_set.id)
    shown = shown_by(brought.platform.store, playback)
    assert (playback.state, playback.export_id, len(shown.cameras), shown.has_clouds) == ("ready", export.id, 6, True)
    with brought.platform.database.transaction() as session:
        again, _ = start_export(session, brought.sequence(), "playback")
        assert again.id == export.id, "who asks for it is given the one that stands"


def test_a_run_that_is_published_twice_has_one_label_set_and_is_followed_once(unpublished: tuple[Brought, str]) -> None:
    brought, run_id = unpublished
    run_all(brought.platform)
    with brought.platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == run_id).values(state="running"))
        session.execute(update(Job).where(Job.kind == "labeler.publish").values(state="queued", attempts_left=3))
    assert run_all(brought.platform) == 1
    (label_set,) = brought.label_sets()
    assert brought.job(run_id).result["label_set_id"] == label_set.id  # type: ignore[index]
    assert len(exports_of(brought)) == 1


def switched_off(brought: Brought) -> Brought:
    settings = brought.platform.settings.model_copy(update={"viewing": ViewingSettings(makes_playback=False)})
    return replace(brought, platform=replace(brought.platform, settings=settings))


def draining(brought: Brought) -> Brought:
    with brought.platform.database.transaction() as session:
        set_mode(session, "labeler", "draining")
    return brought


def without_recording(brought: Brought) -> Brought:
    with brought.platform.database.transaction() as session:
        session.execute(delete(Recording))
    return brought


@pytest.mark.parametrize("change", [switched_off, draining, without_recording])
def test_labels_are_published_where_no_playback_may_follow(
    unpublished: tuple[Brought, str], change: Callable[[Brought], Brought]
) -> None:
    brought, run_id = change(unpublished[0]), unpublished[1]
    assert run_all(brought.platform) == 1
    assert (brought.job(run_id).state, len(brought.label_sets()), exports_of(brought)) == ("succeeded", 1, [])
