"""Checking a sequence leaves a picture per camera with the LiDAR's points on it, of the recipe that made the sequence.

Catches alone overlays of another recipe, or none after a killed attempt.
"""

from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image
from sqlalchemy import select

from services.domain.sequences.processing import delete_sequence
from services.runtime.orm import Blob, Preview
from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from testing.worlds.runs import Brought, bring, run_all
from tests.services.ingest.killed_checks import killed_once

pytestmark = pytest.mark.whole

SEEN = SimulateOptions(seconds=0.6, seed=3, channels=16, columns=120)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("seen") / "run.mcap"
    simulate(path, SEEN)
    return path


@pytest.fixture
def brought(platform: Platform, bag: Path) -> Brought:
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    brought.add(bag)
    run_all(platform)
    return brought


def overlays(brought: Brought) -> dict[tuple[str, str], Preview]:
    with brought.platform.database.reading() as session:
        rows = session.scalars(select(Preview).where(Preview.recording_id.is_(None)))
        return {(row.recipe, row.name): row for row in rows}


def test_every_camera_has_its_overlay_and_a_killed_attempt_leaves_the_same(brought: Brought) -> None:
    root_id = brought.process(stages=("synchronise",))
    run_all(brought.platform, wrap=killed_once)
    assert (brought.job(root_id).state, brought.job(root_id).failure) == ("succeeded", "")
    recipe = brought.job(root_id).arguments["recipe"]
    kept = overlays(brought)
    assert {of for of, _name in kept} == {recipe}
    assert len(kept) == 6
    with brought.platform.database.reading() as session:
        keys = [session.get_one(Blob, row.blob_sha256).object_key for row in kept.values()]
    for key in keys:
        picture = Image.open(BytesIO(b"".join(brought.platform.store.read(key))))
        assert picture.format == "JPEG"
    again = brought.process(stages=("synchronise",))
    run_all(brought.platform)
    assert brought.job(again).state == "succeeded"
    assert {at: row.blob_sha256 for at, row in overlays(brought).items()} == {
        at: row.blob_sha256 for at, row in kept.items()
    }


def test_overlays_go_with_their_sequence(brought: Brought) -> None:
    brought.process(stages=("synchronise",))
    run_all(brought.platform)
    assert overlays(brought)
    with brought.platform.database.transaction() as session:
        delete_sequence(session, brought.sequence())
    with brought.platform.database.reading() as session:
        assert session.scalars(select(Preview)).all() == []
