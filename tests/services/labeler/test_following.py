"""Labels that are published are followed by their playback: once, last of all that waits, and never in their way.

Catches alone a playback that is made twice, or that holds up or spoils the labels it follows.
"""

from dataclasses import replace

import pytest
from sqlalchemy import delete, select, update

from services.domain.exports.requests import start_export
from services.domain.viewer.playback import playback_of, shown_by
from services.runtime.jobs.control import set_mode
from services.runtime.orm import Export, Job, LabelSet, Recording
from services.runtime.settings import ViewingSettings
from testing.worlds.runs import Brought, run_all
from tests.services.labeler.test_export_stage import brought, labelled
from tests.services.labeler.test_stages import publish_again

pytestmark = pytest.mark.whole

__all__ = ["brought", "labelled"]  # fixtures


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
    assert (playback.state, playback.export_id, shown.cameras, shown.has_clouds) == ("ready", export.id, (), True)
    with brought.platform.database.transaction() as session:
        again, _ = start_export(session, brought.sequence(), "playback")
        assert again.id == export.id, "who asks for it is given the one that stands"


def test_a_run_that_is_published_twice_is_followed_once(unpublished: tuple[Brought, str]) -> None:
    brought, run_id = unpublished
    run_all(brought.platform)
    with brought.platform.database.transaction() as session:
        session.execute(update(Job).where(Job.id == run_id).values(state="running"))
        session.execute(update(Job).where(Job.kind == "labeler.publish").values(state="queued", attempts_left=3))
    assert run_all(brought.platform) == 1
    assert len(exports_of(brought)) == 1


def test_nothing_follows_where_that_is_switched_off(unpublished: tuple[Brought, str]) -> None:
    brought, _ = unpublished
    settings = brought.platform.settings.model_copy(update={"viewing": ViewingSettings(makes_playback=False)})
    assert run_all(replace(brought.platform, settings=settings)) == 1
    assert (len(brought.label_sets()), exports_of(brought)) == (1, [])


def test_labels_are_published_though_the_queue_takes_nothing_new(unpublished: tuple[Brought, str]) -> None:
    brought, run_id = unpublished
    with brought.platform.database.transaction() as session:
        set_mode(session, "labeler", "draining")
    assert run_all(brought.platform) == 1
    assert (brought.job(run_id).state, len(brought.label_sets()), exports_of(brought)) == ("succeeded", 1, [])


def test_labels_are_published_though_their_recording_is_gone(unpublished: tuple[Brought, str]) -> None:
    brought, run_id = unpublished
    with brought.platform.database.transaction() as session:
        session.execute(delete(Recording))
    assert run_all(brought.platform) == 1
    assert (brought.job(run_id).state, len(brought.label_sets()), exports_of(brought)) == ("succeeded", 1, [])


def test_a_playback_that_fails_leaves_the_labels_as_they_are(unpublished: tuple[Brought, str]) -> None:
    brought, run_id = unpublished
    full = replace(brought.platform.settings.uploads, owner_bytes=1)
    settings = brought.platform.settings.model_copy(update={"uploads": full})
    run_all(replace(brought.platform, settings=settings))
    (export,) = exports_of(brought)
    assert (brought.job(export.job_id).state, brought.job(export.job_id).failure_code) == ("failed", "quota_exceeded")
    assert brought.job(run_id).state == "succeeded"
    with brought.platform.database.reading() as session:
        label_set_id = session.scalars(select(LabelSet.id)).one()
        assert playback_of(session, label_set_id).state == "none"
