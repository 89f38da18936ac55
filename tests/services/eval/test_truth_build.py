"""A ground truth is what the labels of a dataset version's part say, to the voxel; nothing of them leaves its job."""

import json
import mmap
import os
import re
import signal
import socket
from collections.abc import Callable, Iterator
from collections.abc import Sequence as Listing
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.phases.unordered_frames import unordered_frames
from services.eval import sandboxed_truth, truth_build
from services.eval.ground_truth import read_truth, truth_in
from services.eval.sandboxed_truth import TruthAnswer, TruthInputs, write_truth
from services.eval.truth_pack import TruthPack
from services.runtime.orm import (
    Activation,
    Blob,
    Dataset,
    DatasetPack,
    GroundTruthRow,
    Job,
    JobLine,
    Phase,
    SequenceRow,
    new_id,
)
from services.runtime.platform import Platform
from services.runtime.sandbox import ProgressCallback, job_sandbox
from stone.scoring.frame_counts import TruthPlanes
from stone.scoring.truth_hash import truth_hash, whole_hash
from stone_base.label_grid import LabelGrid
from stone_files.npz import npz_bytes
from stone_submissions.ground_truth import MAX_LABELS_BYTES, Mask, find_ground_truth
from stone_submissions.manifest import read_manifest
from testing.api.serving import person
from testing.worlds import made, published
from testing.worlds.benchmark_world import Grid, World, ground, labels_npz, new_truth, run_eval
from testing.worlds.sending import standing_world, truth_folder
from tests.services.eval.attacks import BOMB_BYTES, FREE, bomb


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path) -> Iterator[World]:
    with standing_world(tmp_path_factory.mktemp("truths"), _sqlite_template, frames=2) as standing:
        yield standing


def truths(world: World, phase_id: str) -> Listing[GroundTruthRow]:
    of_phase = select(GroundTruthRow).where(GroundTruthRow.phase_id == phase_id).order_by(GroundTruthRow.number)
    with world.platform.database.reading() as session:
        return session.scalars(of_phase).all()


def local(platform: Platform, sha256: str | None) -> Path:
    with platform.database.reading() as session:
        return platform.store.local(session.get_one(Blob, sha256).object_key)


def masked_phase(world: World, mask: str, every_nth: int | None = None) -> str:
    """The id of a phase over test that evaluates by this mask, its ground truth ready."""
    with world.platform.database.transaction() as session:
        version = session.scalars(select(Dataset).where(Dataset.name == world.dataset)).one()
        asked = NewBenchmark(f"by-{mask}-{new_id()[-4:]}", "", "", world.administrator.user_id)
        benchmark = create_benchmark(session, asked)
        new = NewPhase("test", "test", True, mask, every_nth=every_nth)  # type: ignore[arg-type]
        phase = create_phase(session, benchmark, version, new)
        start_truth(session, phase, version, world.administrator.user_id)
        phase_id = phase.id
    run_eval(world.platform)
    return phase_id


def test_the_manifest_names_every_frame_in_time_and_the_facts_each_sequence(world: World) -> None:
    (truth,) = truths(world, world.test)
    manifest = read_manifest(local(world.platform, truth.manifest_sha256))
    assert {name: list(tokens) for name, tokens in manifest.sequences.items()} == {
        name: list(grids) for name, grids in world.grids["test"].items()
    }
    assert truth.frames == len(manifest.tokens)
    said = truth.facts["sequences"]
    assert [one["name"] for one in said] == list(manifest.sequences)
    assert {(one["environment"], one["illumination"], one["frames"]) for one in said} == {
        ("quarry", "day", 2),
        ("farmland", "dusk", 2),
    }


@pytest.mark.parametrize("mask", ["all", "lidar"])
def test_the_pack_holds_the_labels_and_its_hash_is_that_of_the_command(world: World, mask: str, tmp_path: Path) -> None:
    (truth,) = truths(world, world.test if mask == "all" else masked_phase(world, mask))
    folder = find_ground_truth(truth_folder(world, "test", tmp_path), mask)  # type: ignore[arg-type]
    expected = {token: read_truth(path, folder.mask) for token, path in folder.paths().items()}
    assert truth.sha256 == whole_hash({token: truth_hash(planes) for token, planes in expected.items()})
    with TruthPack(local(world.platform, truth.pack_sha256)) as pack:
        assert set(pack.tokens) == set(expected)
        for index, token in enumerate(pack.tokens):
            assert np.array_equal(pack.planes(index).planes, expected[token].planes)
            assert np.array_equal(pack.planes(index).counts, expected[token].counts)


@pytest.mark.parametrize("every_nth", [1, 2])
def test_a_phase_without_order_has_the_labels_under_tokens_of_its_own(world: World, every_nth: int) -> None:
    phase_id = masked_phase(world, "all", every_nth)
    (truth,), (ordered,) = truths(world, phase_id), truths(world, world.test)
    with world.platform.database.reading() as session:
        phase = session.get_one(Phase, phase_id)
        chosen = unordered_frames(phase.every_nth, phase.token_key)
    assert chosen is not None
    manifest = read_manifest(local(world.platform, truth.manifest_sha256))
    own = {name: tuple(grids) for name, grids in world.grids["test"].items()}
    expected = {name: chosen.of(tokens) for name, tokens in own.items()}
    assert {name: list(tokens) for name, tokens in manifest.sequences.items()} == {
        name: [token for token, _ in frames] for name, frames in expected.items()
    }
    said = {one["name"]: (one["frames"], one["places"]) for one in truth.facts["sequences"]}
    assert said == {name: (len(frames), [at for _, at in frames]) for name, frames in expected.items()}
    assert truth.frames == sum(-(-len(tokens) // every_nth) for tokens in own.values())
    packs = (local(world.platform, one.pack_sha256) for one in (truth, ordered))
    with TruthPack(next(packs)) as pack, TruthPack(next(packs)) as whole:
        for name, frames in expected.items():
            for token, at in frames:
                assert (pack.planes_of(token).planes == whole.planes_of(own[name][at]).planes).all()


def test_the_first_is_put_in_force_and_no_other(world: World) -> None:
    first = truths(world, world.val)[0]
    again = new_truth(world.platform, world.val, world.administrator.user_id)
    with world.platform.database.reading() as session:
        in_force = session.scalars(select(Activation.truth_id).where(Activation.phase_id == world.val)).all()
    assert in_force == [first.id]
    assert (truths(world, world.val)[-1].id, truths(world, world.val)[-1].sha256) == (again, first.sha256)


def test_building_it_again_changes_nothing(world: World) -> None:
    (before,) = truths(world, world.test)
    with world.platform.database.transaction() as session:
        session.get_one(Job, before.job_id).state = "queued"
    assert run_eval(world.platform) == 1
    (after,) = truths(world, world.test)
    assert (after.ready_ns, after.pack_sha256, after.facts) == (before.ready_ns, before.pack_sha256, before.facts)


def unfit(platform: Platform, content: bytes) -> tuple[str, Job, list[JobLine]]:
    """A phase, the job that was to build its ground truth of a frame with this label file, and what it logged."""
    administrator, name = person(platform, "administrator"), f"broken-{new_id()[-6:]}"
    with platform.database.transaction() as session:
        sequence = SequenceRow(owner_id=administrator.user_id, name=name)
        session.add(sequence)
        session.flush()
        said = {"id": sequence.id, "name": name, "owner_id": administrator.user_id}
    made.labels(platform, said, contents=[content])
    version = published.dataset(platform, administrator.user_id, {"test": [said["id"]]})
    with platform.database.transaction() as session:
        dataset = session.scalars(select(Dataset).where(Dataset.name == version)).one()
        benchmark = create_benchmark(session, NewBenchmark(name, "", "", administrator.user_id))
        phase: Phase = create_phase(session, benchmark, dataset, NewPhase("test", "test", True, "lidar"))
        _, job = start_truth(session, phase, dataset, administrator.user_id)
    run_eval(platform)
    with platform.database.reading() as session:
        lines = session.scalars(select(JobLine).where(JobLine.job_id == job.id)).all()
        return phase.id, session.get_one(Job, job.id), list(lines)


def beyond(grid: Grid) -> Grid:
    spoilt = grid.copy()
    spoilt[3, 4, 5] = 217
    return spoilt


MASKED = {"mask_lidar": np.ones((256, 256, 32), np.uint8)}
UNFIT = {
    "no npz": b"no npz",
    "no mask": npz_bytes({"semantics": ground(1)}),  # which the phase needs
    "a label that is none": npz_bytes({"semantics": beyond(ground(1)), **MASKED}),
    "another shape": npz_bytes({"semantics": ground(1)[:-1], **MASKED}),
    "numbers that are none": npz_bytes({"semantics": np.full((256, 256, 32), np.nan), **MASKED}),
    "a zip bomb": bomb(BOMB_BYTES),
    "a zip bomb that says it is small": bomb(FREE.nbytes + 128),
    "cut off": labels_npz(ground(1))[:-40],
    "longer than any label file": bytes(MAX_LABELS_BYTES + 1),
}


@pytest.mark.whole
@pytest.mark.parametrize("content", UNFIT.values(), ids=UNFIT.keys())
def test_labels_that_are_none_end_the_job_without_a_word_of_what_they_hold(world: World, content: bytes) -> None:
    phase_id, job, lines = unfit(world.platform, content)
    assert (job.state, job.failure_code, job.attempt) == ("failed", "labels_unfit", 1)
    words = job.failure + json.dumps([(line.event, line.facts) for line in lines])
    assert "217" not in re.sub(r"gts/[^ ]+", "the file", words), "the name of a frame is no secret, its labels are"
    assert [truth.ready_ns for truth in truths(world, phase_id)] == [None]
    with world.platform.database.reading() as session:
        assert session.scalars(select(Activation.id).where(Activation.phase_id == phase_id)).all() == []


def killed_at_first() -> Callable[..., bytes]:
    """The work, whose first process is killed, as by a machine that is short of memory."""
    has_begun = mmap.mmap(-1, 1)  # what a child writes there, the next one sees

    def work(inputs: TruthInputs, folder: Path, progress: ProgressCallback) -> bytes:
        if not has_begun[0]:
            has_begun[0] = 1
            os.kill(os.getpid(), signal.SIGKILL)
        return write_truth(inputs, folder, progress)

    return work


def begun(world: World) -> str:
    """The id of the job of another ground truth of the test phase."""
    with world.platform.database.transaction() as session:
        phase = session.get_one(Phase, world.test)
        version = session.get_one(Dataset, phase.dataset_id)
        return start_truth(session, phase, version, world.administrator.user_id)[1].id


def job_of(world: World, job_id: str) -> Job:
    with world.platform.database.reading() as session:
        return session.get_one(Job, job_id)


def test_no_label_file_is_opened_in_the_worker_itself(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    opened_here = list[str]()

    def noted(npz: bytes, mask: Mask, path: Path, grid: LabelGrid) -> TruthPlanes:
        opened_here.append(str(path))
        return truth_in(npz, mask, path, grid)

    monkeypatch.setattr(sandboxed_truth, "truth_in", noted)
    job_id = begun(world)
    run_eval(world.platform)
    assert job_of(world, job_id).state == "succeeded"
    assert opened_here == []


def test_a_child_that_is_killed_costs_one_attempt(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    first = truths(world, world.test)[0]
    monkeypatch.setattr(truth_build, "write_truth", killed_at_first())
    job_id = begun(world)
    run_eval(world.platform)
    job = job_of(world, job_id)
    assert (job.state, job.attempt) == ("succeeded", 2)
    assert truths(world, world.test)[-1].pack_sha256 == first.pack_sha256


ATTACKS: dict[str, tuple[Callable[..., object], str]] = {
    "a crash": (lambda *_: os.abort(), "was ended by SIGABRT"),
    "all memory": (lambda *_: bytearray(2 * job_sandbox.MEMORY_BYTES), "needed more than"),
    "a connection": (lambda *_: socket.create_connection(("127.0.0.1", 9)), "raised PermissionError"),
    "an answer of its own": (lambda *_: b'{"sha256":"","frames":1}', "something else than the summary of the"),
    "no file": (lambda *_: TruthAnswer(sha256="0" * 64, frames=4).packed(), "built something other than requested"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_child_that_is_taken_over_fails_its_job_with_a_code(
    world: World, attack: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, fate = ATTACKS[attack]
    monkeypatch.setattr(truth_build, "write_truth", work)
    job_id = begun(world)
    run_eval(world.platform)
    job = job_of(world, job_id)
    assert (job.state, job.failure_code, job.attempt) == ("failed", "reader_crashed", 1)
    assert fate in job.failure


def test_labels_that_changed_in_the_store_are_not_taken(world: World) -> None:
    with world.platform.database.reading() as session:
        phase = session.get_one(Phase, world.test)
        first = session.get_one(DatasetPack, (phase.dataset_id, "test", 0))
    pack = local(world.platform, first.blob_sha256)
    sound = pack.read_bytes()
    pack.write_bytes(sound[:60] + bytes([sound[60] ^ 1]) + sound[61:])
    try:
        with world.platform.database.transaction() as session:
            version = session.get_one(Dataset, phase.dataset_id)
            _, job = start_truth(session, session.get_one(Phase, phase.id), version, world.administrator.user_id)
        run_eval(world.platform)
    finally:
        pack.write_bytes(sound)
    with world.platform.database.reading() as session:
        failed = session.get_one(Job, job.id)
    assert (failed.state, failed.failure_code) == ("failed", "labels_unfit")
    assert "sha256" in failed.failure
