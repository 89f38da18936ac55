"""A benchmark at the release's grid: its submissions are scored at it, and no other grid comes in."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.datasets.versions import grid_of_members
from services.domain.sequences.label_comparisons import start_comparison
from services.eval.pipeline import score
from services.runtime.orm import Blob, Dataset, GroundTruthRow, LabelSet, Phase, SequenceRow
from stone.scoring.metric import RATIOS
from stone_base.label_grid import PAPER, RELEASE, recorded_grid
from stone_submissions.manifest import read_manifest
from testing.refusals import refused_as
from testing.worlds import made, published
from testing.worlds.benchmark_world import World, ground, labelled, labels_npz, run_eval
from testing.worlds.sending import guess, pair_of, row_of, scores_of, send, standing_world, truth_folder, zipped
from testing.worlds.submission_files import write_submission


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path_factory.mktemp("release"), _sqlite_template, grid=RELEASE) as found:
        yield found


def test_a_submission_is_scored_at_the_grid_of_its_phase(world: World, tmp_path: Path) -> None:
    frames = guess(world)
    submission_id = send(world, zipped(world, frames))
    run_eval(world.platform)
    (row,) = scores_of(world.platform, submission_id)
    (tmp_path / "guess.zip").write_bytes(zipped(world, frames))
    told = score(tmp_path / "guess.zip", truth_folder(world, "val", tmp_path)).as_record()
    assert row.signature == told["signature"]
    assert "grid:200x200x16@0.4m[-40,-40,-1]" in row.signature
    assert {name: getattr(row, name) for name in RATIOS} == told["total"]
    assert sum(map(sum, row.record["confusion"])) == len(frames) * RELEASE.voxels


def test_a_submission_of_the_papers_grid_is_refused_with_the_shape_of_the_phase(world: World) -> None:
    path = Path(world.platform.settings.root) / "paper.zip"
    write_submission(path, ((token, ground(3)) for token in world.truth("val")))
    submission_id = send(world, path.read_bytes())
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert row.state == "invalid"
    first = (row.problems or {})["errors"][0]
    assert (first["code"], first["expected"], first["actual"]) == ("bad_shape", "(200, 200, 16)", "(256, 256, 32)")


def test_version_manifest_and_ground_truth_name_the_grid(world: World) -> None:
    platform = world.platform
    with platform.database.reading() as session:
        phase = session.get_one(Phase, world.val)
        dataset = session.get_one(Dataset, phase.dataset_id)
        truth = session.get_one(GroundTruthRow, pair_of(world, "val").truth_id)
        key = session.get_one(Blob, truth.manifest_sha256).object_key
        assert recorded_grid(dataset.grid) == RELEASE
        assert recorded_grid(truth.facts["grid"]) == RELEASE
    assert read_manifest(platform.store.local(key)).grid == RELEASE


def test_a_version_has_one_grid_and_a_phase_keeps_its_own(world: World) -> None:
    platform, owner = world.platform, world.curator
    others = [labelled(platform, owner, f"other-{n}", [ground(40 + n)]) for n in range(3)]
    parts = dict(zip(("train", "val", "test"), ([one] for one in others), strict=True))
    name = published.dataset(platform, world.administrator.user_id, parts)
    with platform.database.transaction() as session:
        other = session.query(Dataset).filter(Dataset.name == name).one()
        assert other.grid is None
        with refused_as("grids_differ"):
            start_truth(session, session.get_one(Phase, world.val), other, world.administrator.user_id)
    with platform.database.reading() as session:
        val = [row for row in session.query(SequenceRow).all() if row.name.startswith("val-")]
    mixed = {"train": parts["train"], "val": [val[0].id], "test": parts["test"]}
    with refused_as("mixed_grids") as refusal:
        published.dataset(platform, world.administrator.user_id, mixed)
    assert "release" in str(refusal.value)
    assert "paper" in str(refusal.value)
    assert grid_of_members({}) == PAPER


def test_label_sets_of_two_grids_are_not_compared(world: World) -> None:
    platform = world.platform
    sequence_id = labelled(platform, world.curator, "twice", [ground(50)])
    facts = {"id": sequence_id, "name": "twice", "owner_id": world.curator.user_id}
    coarse = labels_npz(ground(50)[:200, :200, :16].copy())
    second = made.labels(platform, facts, seed=b"2", contents=[coarse], grid=RELEASE)
    with platform.database.transaction() as session:
        sequence = session.get_one(SequenceRow, sequence_id)
        first = session.query(LabelSet).filter(LabelSet.sequence_id == sequence_id, LabelSet.id != second.id).one()
        with refused_as("grids_differ") as refusal:
            start_comparison(session, sequence, first.id, second.id)
    assert "0.4 m" in str(refusal.value)
