"""Late voxels are scored separately: counts by numpy alone, packs, and scores of labels rebuilt from the inputs."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.domain.benchmarks.alarms.alarms import DEFAULTS, ScoredEntry, late_suspicion
from services.eval.examination import ARRAYS, counts_of, examined
from services.eval.ground_truth import read_truth
from services.eval.pipeline import score
from services.eval.truth_pack import TruthPack, write_truth_pack
from services.labeler.local_run import label
from stone.labels.baseline import predict_from_sweep
from stone.scoring.confusion import named_ratios
from stone.scoring.truth_hash import truth_hash
from stone.sensors.calibration import Box
from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from stone_submissions.archive import open_submission
from stone_submissions.ground_truth import find_ground_truth
from testing.worlds.submission_files import write_submission
from tests.plain_confusion import confusion_matrix
from tests.services.eval.conftest import Grid, speckled
from tests.services.labeler.worlds import EGO_FROM_LIDAR, RayCast, World, sequence_of

TOKENS = tuple(frame_token("north", stamp_ns) for stamp_ns in range(3))


@pytest.fixture(scope="module")
def marked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Mapping[str, Mapping[str, Grid]]]:
    """A ground truth whose last frame does not mark late voxels, and its arrays by token."""
    folder = tmp_path_factory.mktemp("marked")
    arrays = dict[str, Mapping[str, Grid]]()
    for index, token in enumerate(TOKENS):
        late = (speckled(40 + index) > 1).astype(np.uint8)
        arrays[token] = {"semantics": speckled(index), "mask_lidar": (speckled(9) == 0).astype(np.uint8), "late": late}
        kept = {name: grid for name, grid in arrays[token].items() if name != "late" or index < 2}
        (folder / "gts" / "north" / token).mkdir(parents=True)
        (folder / "gts" / "north" / token / "labels.npz").write_bytes(npz_bytes(kept))
    return folder, arrays


@pytest.mark.parametrize("mask", ["all", "lidar"])
def test_late_voxels_are_counted_as_numpy_counts_them(marked, tmp_path, mask) -> None:
    folder, arrays = marked
    guesses = {token: np.where(speckled(70) > 0, speckled(71), arrays[token]["semantics"]) for token in TOKENS}
    write_submission(tmp_path / "sub.zip", guesses.items())
    truth = find_ground_truth(folder, mask)
    paths = truth.paths()
    write_truth_pack(tmp_path / "p", truth.manifest, lambda token: read_truth(paths[token], mask))
    late, elsewhere = np.zeros((4, 4), np.int64), np.zeros((4, 4), np.int64)
    for token in TOKENS[:2]:
        evaluated = np.ones(PAPER.shape, np.bool_) if mask == "all" else arrays[token]["mask_lidar"] > 0
        for total, where in ((late, arrays[token]["late"] > 0), (elsewhere, arrays[token]["late"] == 0)):
            total += confusion_matrix(arrays[token]["semantics"], guesses[token], evaluated & where)
    found = score(tmp_path / "sub.zip", folder, mask=mask).as_record()["late"]
    assert found["frames"] == 2
    assert (found["ratios"], found["elsewhere"]) == (named_ratios(late), named_ratios(elsewhere))
    assert list(found["support"].values()) == late.sum(axis=1).tolist()
    with TruthPack(tmp_path / "p") as pack, open_submission(tmp_path / "sub.zip", TOKENS) as submission:
        counts = examined(submission, TOKENS, pack.planes_of, sampled=frozenset(TOKENS)).counts
    assert counts is not None
    assert (counts_of(counts.raw(), 3).arrays()["late"].sum(axis=0) == late).all()
    assert list(counts.arrays()) == list(ARRAYS)


def test_a_pack_keeps_late_voxels_and_is_named_without_them(marked, tmp_path) -> None:
    folder, _ = marked
    truth = find_ground_truth(folder)
    read = {token: read_truth(path, "all") for token, path in truth.paths().items()}
    for name, planes in (("p", read), ("without", {token: replace(one, late=None) for token, one in read.items()})):
        summary = write_truth_pack(tmp_path / name, truth.manifest, lambda token, planes=planes: planes[token])
        with TruthPack(tmp_path / name) as pack:
            for token in TOKENS:
                found, expected = pack.planes_of(token), planes[token]
                assert (found.planes == expected.planes).all()
                assert (found.late is None) == (expected.late is None)
                assert found.late is None or (found.late == expected.late).all()
        assert summary.sha256 == score_name(tmp_path, folder)
    assert read[TOKENS[2]].late is None
    assert truth_hash(read[TOKENS[0]]) == truth_hash(replace(read[TOKENS[0]], late=None))


def score_name(tmp_path: Path, folder: Path) -> str:
    write_submission(tmp_path / "empty.zip", ((token, np.zeros(PAPER.shape, np.uint8)) for token in TOKENS))
    return score(tmp_path / "empty.zip", folder).signature.ground_truth


@pytest.mark.whole
def test_labels_rebuilt_from_the_inputs_raise_the_alarm_and_a_single_sweep_does_not(tmp_path: Path) -> None:
    """The attack: the sweeps and poses of a hidden phase, labelled by this platform's own labelling."""
    boxes = tuple(Box((x, y, 0.0), (x + 0.9, y + 0.9, 1.2)) for x in (-6.0, 2.0, 9.0) for y in (-3.5, 2.5))
    world = World(grade=(0.05, 0.02), boxes=boxes, frames=20, step_m=0.6, reach_m=9.0)
    sequence, sweeps = sequence_of(world), RayCast(world)
    for name in ("truth", "attack"):  # the phase's truth, and labels that a participant makes from its inputs
        label(sequence, sweeps, tmp_path / name)
    tokens = sequence.frames.tokens
    rebuilt = {token: np.load(tmp_path / "attack/gts/small" / token / "labels.npz")["semantics"] for token in tokens}
    seen = {
        token: predict_from_sweep((EGO_FROM_LIDAR @ sweeps.sweep(index).points_lidar).astype(np.float32))
        for index, token in enumerate(tokens)
    }
    limits = replace(DEFAULTS, late_voxels=500)
    for frames, kinds in ((rebuilt, ["late_as_good"]), (seen, [])):
        write_submission(tmp_path / "sub.zip", frames.items())
        late = score(tmp_path / "sub.zip", tmp_path / "truth").as_record()["late"]
        about = ScoredEntry("s", "t", "Ours", "Net", 0, "", np.zeros(1, np.int64))
        assert [one.kind for one in late_suspicion(about, late, limits)] == kinds
        assert sum(list(late["support"].values())[1:]) > 500
