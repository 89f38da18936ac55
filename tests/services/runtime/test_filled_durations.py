"""How long label sets last that were made before that was written down: as the labeler would have written it."""

from random import Random

import numpy as np
import pytest
from alembic.migration import MigrationContext
from alembic.operations import Operations
from sqlalchemy import update

from services.runtime.access.users import create_user
from services.runtime.database.migrations.versions.r0001_r0020 import r0008_datasets
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Artefact, Blob, LabelledFrameRow, LabelSet, SequenceRow
from services.runtime.platform import Platform
from stone.splits.composition import duration_ns

START_NS = 1_777_800_000_000_000_000


def labelled(platform: Platform, stamps_ns: list[int]) -> str:
    """The id of a label set with frames of these stamps, of a version that kept no duration."""
    with platform.database.transaction() as session:
        owner = create_user(session, "ada", "curator")
        sequence = SequenceRow(owner_id=owner.id, name="run")
        session.add_all([sequence, Blob(sha256="ab" * 32, object_key="blobs/ab", size_bytes=1)])
        session.flush()
        run = enqueue_run(session, "sequence.process", [JobSpec("ingest.synchronise")], Context(owner.id, sequence.id))
        labels = LabelSet(sequence_id=sequence.id, job_id=run.id, recipe="r", parameters={}, code_version="0", frames=1)
        session.add(labels)
        session.flush()
        pack = Artefact(label_set_id=labels.id, name="labels/000000.pack", media_type="", size_bytes=1)
        pack.blob_sha256 = "ab" * 32
        session.add(pack)
        session.flush()
        facts = {"label_set_id": labels.id, "pack_id": pack.id, "offset_bytes": 0, "length_bytes": 1, "sha256": ""}
        session.add_all(
            LabelledFrameRow(ordinal=n, token=f"{n:032x}", stamp_ns=stamp, **facts) for n, stamp in enumerate(stamps_ns)
        )
        session.execute(update(LabelSet).values(duration_ns=None))
        return labels.id


@pytest.mark.parametrize("frames", [0, 1, 2, 7, 300])
def test_the_revision_fills_in_what_the_labeler_would_write(platform_on: Platform, frames: int) -> None:
    random = Random(frames)
    stamps = np.cumsum([START_NS, *(random.randrange(9 * 10**7, 11 * 10**7) for _ in range(frames))])[:frames]
    label_set_id = labelled(platform_on, stamps.tolist())
    with platform_on.database.engine.begin() as connection:
        context = MigrationContext.configure(connection)
        with Operations.context(context):
            r0008_datasets._fill_durations()
    with platform_on.database.reading() as session:
        assert session.get_one(LabelSet, label_set_id).duration_ns == duration_ns(stamps)


def test_a_sequence_lasts_as_long_as_its_frames_stand_for() -> None:
    stamps = START_NS + 10**8 * np.arange(200)
    assert duration_ns(stamps) == 20 * 10**9, "200 frames at 10 Hz are 20 s, not 19.9"
