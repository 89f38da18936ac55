"""Scores are those of a plain histogram over the files; what cannot be scored is refused whole."""

import json
import secrets
import shutil
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from services.domain.benchmarks.submissions import scoring_ranges
from services.eval.examination import count_range
from services.eval.ground_truth import read_truth
from services.eval.pipeline import score
from stone.scoring.confusion import named_ratios
from stone.scoring.frame_counts import TruthPlanes
from stone.scoring.metric import RATIOS
from stone_base.label_grid import PAPER
from stone_files.dataset_layouts import LAYOUTS
from stone_files.npz import npz_bytes
from stone_local.frame_order import TABLE, in_time_order
from stone_submissions.archive import open_submission
from stone_submissions.errors import GroundTruthError, UnreadableInputError
from stone_submissions.ground_truth import Mask, TimedSequence, find_ground_truth
from stone_submissions.validation import check_range, validate
from stone_submissions.verdict import SubmissionRefusedError
from testing.refusals import refused_as
from testing.worlds.released_datasets import ReleasedDataset, write_released
from testing.worlds.submission_files import write_submission
from tests.plain_confusion import confusion_matrix
from tests.services.eval.conftest import Grid, World, speckled
from tests.slow_metric import added_columns, slow_counts, slow_ratios, slow_tolerant

TOLD = ["frames", "total", "within_occupied", "tolerant", "columns", "late", "support", "confusion", "extras"]
TOLD += ["intervals", "silences", "by", "cells"]
KEYS = [*TOLD, "signature", "code_version"]


@pytest.fixture
def submission(world: World, tmp_path: Path) -> Path:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    return tmp_path / "sub.zip"


def plain_confusion(world: World, mask: Mask) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """The oracle: numpy alone, on the arrays that the files were written from."""
    everywhere, nowhere = np.ones(PAPER.shape, np.bool_), np.zeros(PAPER.shape, np.bool_)
    total = np.zeros((4, 4), np.int64)
    for token, labels in world.labels.items():
        evaluated = {"all": everywhere, "lidar": world.masks[token] > 0, "camera": nowhere}[mask]
        total += confusion_matrix(labels, world.predictions[token], evaluated)
    return total


@pytest.mark.parametrize("mask", ["all", "lidar", "camera"])
@pytest.mark.parametrize("threads", [1, 2])
def test_scores_are_those_of_a_plain_histogram(mask: Mask, threads: int, world: World, submission: Path) -> None:
    record = score(submission, world.folder, mask=mask, threads=threads).as_record()
    expected = plain_confusion(world, mask)
    assert list(record) == KEYS
    assert record["frames"] == 3
    assert record["confusion"] == expected.tolist()
    assert record["total"] == named_ratios(expected)
    assert json.loads(json.dumps(record, allow_nan=False)) == record


@pytest.mark.parametrize("mask", ["all", "lidar"])
def test_occupied_voxels_of_low_confidence_are_left_out(
    mask: Mask, world: World, submission: Path, tmp_path: Path
) -> None:
    confidence = {token: speckled(30 + at, 256) for at, token in enumerate(world.labels)}
    expected, left_out, occupied = np.zeros((4, 4), np.int64), 0, 0
    for path in world.folder.glob("gts/*/*/labels.npz"):
        token = path.parent.name
        labels, sure = world.labels[token], np.where(world.labels[token] == 0, 0, 255 - confidence[token])
        write_labels(tmp_path / path.relative_to(world.folder), np.load(path), confidence=sure.astype(np.uint8))
        is_evaluated = (world.masks[token] > 0) | (mask == "all")
        is_unsure = (labels > 0) & (sure / 255 < 0.8)
        expected += confusion_matrix(labels, world.predictions[token], is_evaluated & ~is_unsure)
        left_out += int((is_evaluated & is_unsure).sum())
        occupied += int((is_evaluated & (labels > 0)).sum())
    limited = score(submission, tmp_path, mask=mask, least_confidence=0.8).as_record()
    assert limited["confusion"] == expected.tolist()
    assert 0 < left_out < occupied
    told = {"least_confidence": 0.8, "left_out": left_out, "left_out_ratio": left_out / occupied}
    assert limited["confidence"] == told
    assert f"|mask:{mask},confidence>=0.8|" in limited["signature"]
    assert score(submission, tmp_path, mask=mask).as_record() == score(submission, world.folder, mask=mask).as_record()
    with refused_as("no_confidence", match=r"labels\.npz has no array confidence.*stone label --confidence"):
        score(submission, world.folder, least_confidence=0.8)


def write_labels(path: Path, arrays: Mapping[str, Grid], **further: Grid) -> None:
    path.parent.mkdir(parents=True)
    path.write_bytes(npz_bytes({**arrays, **further}))


def test_the_signature_follows_the_ground_truth_and_the_mask_not_the_prediction(
    world: World, submission: Path, tmp_path: Path
) -> None:
    write_submission(tmp_path / "perfect.zip", world.labels.items())
    first = score(submission, world.folder).signature
    assert score(tmp_path / "perfect.zip", world.folder, threads=1).signature == first
    assert score(submission, world.folder, mask="lidar").signature.ground_truth != first.ground_truth
    assert score(submission, world.folder, mask="lidar").signature.mask == "lidar"


def test_the_folder_above_gts_and_gts_itself_are_the_same_ground_truth(world: World, submission: Path) -> None:
    assert score(submission, world.folder).as_record() == score(submission, world.folder / "gts").as_record()


def test_the_ranges_it_is_counted_in_change_nothing(
    world: World, submission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoiled = tmp_path / "spoiled.zip"
    write_submission(spoiled, [(token, grid + np.uint8(2)) for token, grid in world.predictions.items()][1:])
    whole = score(submission, world.folder).as_record(), validate(spoiled, world.manifest_path)
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    told: list[tuple[str, int, int]] = []
    assert score(submission, world.folder, progress=lambda *step: told.append(step)).as_record() == whole[0]
    assert validate(spoiled, world.manifest_path, progress=lambda *step: told.append(step)) == whole[1]
    assert told == [("score", 1, 3), ("score", 2, 3), ("score", 3, 3), ("validate", 2, 2)]


def test_columns_are_counted_in_few_frames_evenly_spaced(
    world: World, submission: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three frames the first and the third, whatever ranges they are counted in."""
    monkeypatch.setattr("stone.scoring.frame_counts.COUNTED_FRAMES", 2)
    everywhere = np.ones(PAPER.shape, np.bool_)
    tokens = find_ground_truth(world.folder).manifest.tokens
    counted = [slow_counts(world.labels[token], world.predictions[token], everywhere) for token in tokens[::2]]
    for part_frames in (500, 1):
        monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
        record = score(submission, world.folder).as_record()
        assert record["tolerant"] == pytest.approx(slow_tolerant(counted))
        assert record["columns"] == pytest.approx(slow_ratios(added_columns(counted), "stone-iou-2"))


def test_missing_frames_are_refused_before_any_is_counted(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", list(world.predictions.items())[:1])
    with pytest.raises(SubmissionRefusedError, match=r"2 problems; .* missing_frame"):
        score(tmp_path / "sub.zip", world.folder)


@pytest.mark.parametrize("name", ["__MACOSX/._predictions", "predictions/.DS_Store"])
def test_what_the_finder_adds_is_refused_with_the_way_to_leave_it_out(
    name: str, world: World, submission: Path
) -> None:
    with zipfile.ZipFile(submission, "a") as archive:
        archive.writestr(name, b"fork")
    (problem,) = validate(submission, world.manifest_path).errors
    assert (problem.code, problem.file) == ("unexpected_file", name)
    assert "zip -r -X" in problem.actual


def test_the_first_hundred_problems_are_told_and_all_are_counted(world: World, tmp_path: Path) -> None:
    grid = next(iter(world.labels.values()))
    write_submission(tmp_path / "sub.zip", ((f"{index:032x}", grid[:]) for index in range(120)))
    verdict = validate(tmp_path / "sub.zip", world.manifest_path)
    assert (len(verdict.errors), verdict.errors_total, verdict.ok) == (100, 123, False)


def test_a_ground_truth_that_is_none_is_refused(world: World, submission: Path, tmp_path: Path) -> None:
    with pytest.raises(UnreadableInputError):
        score(submission, tmp_path / "absent")
    with pytest.raises(GroundTruthError, match="0 label files"):
        score(submission, tmp_path)
    with pytest.raises(UnreadableInputError):
        score(tmp_path / "absent.zip", world.folder)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a" * 32, b"not an npz"),
        ("a" * 32, npz_bytes({"labels": np.zeros(PAPER.shape, np.uint8)})),
        ("a" * 32, npz_bytes({"semantics": np.full(PAPER.shape, 9, np.uint8)})),
        ("a" * 32, npz_bytes({"mask_lidar": np.zeros(PAPER.shape, np.uint8)})),
        ("a" * 32, bytes(9 * 2**20)),
        ("frame-1", b""),
    ],
)
def test_a_broken_label_file_is_refused_with_its_path(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "gts" / "s" / name / "labels.npz"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    write_submission(tmp_path / "sub.zip", [(name, np.zeros(PAPER.shape, np.uint8))])
    with pytest.raises(GroundTruthError, match=r"labels\.npz"):
        score(tmp_path / "sub.zip", tmp_path)


def test_the_writer_takes_only_grids(tmp_path: Path) -> None:
    with refused_as("bad_dtype", match="int64"):
        write_submission(tmp_path / "s.zip", [("a" * 32, np.zeros(PAPER.shape, np.int64))])
    with refused_as("bad_shape", match=r"\(2, 2, 2\)"):
        write_submission(tmp_path / "s.zip", [("a" * 32, np.zeros((2, 2, 2), np.uint8))])
    assert list(tmp_path.iterdir()) == []


def truth_in(world: World, token: str) -> TruthPlanes:
    return read_truth(next(world.folder.glob(f"gts/*/{token}/labels.npz")), "all")


def test_every_problem_of_a_range_is_found_and_its_frames_count_nothing(world: World, tmp_path: Path) -> None:
    tokens = tuple(world.predictions)
    spoiled = [np.where(world.predictions[token] == 3, 200, world.predictions[token]) for token in tokens[:2]]
    write_submission(tmp_path / "sub.zip", zip(tokens[:2], (grid.astype(np.uint8) for grid in spoiled), strict=True))
    with open_submission(tmp_path / "sub.zip", tokens) as submission:
        counted = count_range(submission, tokens, lambda token: truth_in(world, token))
        assert [problem.code for problem in submission.problems] == ["missing_frame"]
        assert tuple(check_range(submission, tokens)) == counted.problems
    assert [(problem.code, problem.frame) for problem in counted.problems] == [
        ("label_out_of_range", token) for token in tokens[:2]
    ]
    assert not counted.confusions.any()
    assert not counted.bev.any()


def test_a_broken_ground_truth_is_no_problem_of_the_submission(world: World, tmp_path: Path) -> None:
    def broken(token: str) -> TruthPlanes:
        raise GroundTruthError(tmp_path / token, "lost")

    write_submission(tmp_path / "sub.zip", world.predictions.items())
    tokens = tuple(world.predictions)
    with open_submission(tmp_path / "sub.zip", tokens) as submission, pytest.raises(GroundTruthError):
        count_range(submission, tokens, broken)


TOKENS = tuple(secrets.token_hex(16) for _ in range(40))
SEQUENCES = {"north": TOKENS[:25], "south": TOKENS[25:]}


def tokens_of(timed: Mapping[str, TimedSequence] | None) -> dict[str, tuple[str, ...]]:
    assert timed is not None
    return {name: one.tokens for name, one in timed.items()}


def write_table(folder: Path, tokens: tuple[str, ...], first_ns: int = 0) -> None:
    """A frame and then one that was excluded, which has a stamp and no token."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = {"frame_token": [*tokens, None], "stamp_ns": range(first_ns, first_ns + len(tokens) + 1)}
    pq.write_table(pa.table({name: list(column) for name, column in rows.items()}), folder / TABLE)


def test_one_table_beside_the_frames_orders_them(tmp_path: Path) -> None:
    write_table(tmp_path, TOKENS)
    by_name = {name: sorted(tokens) for name, tokens in SEQUENCES.items()}
    assert tokens_of(in_time_order(tmp_path / "gts", by_name)) == SEQUENCES


def test_each_sequence_may_bring_its_own_table(tmp_path: Path) -> None:
    for name, tokens in SEQUENCES.items():
        write_table(tmp_path / "gts" / name, tokens, first_ns=1_700_000_000_000_000_000)
    by_name = {name: sorted(tokens) for name, tokens in SEQUENCES.items()}
    assert tokens_of(in_time_order(tmp_path / "gts", by_name)) == SEQUENCES


def write_track(folder: Path, tokens: tuple[str, ...], begin_m: float, **about: object) -> None:
    """A table of frames a tenth of a second and a decimetre apart, as the labeler writes it: 1 m/s from a place on."""
    folder.mkdir(parents=True)
    places_m = [begin_m + 0.1 * at for at in range(len(tokens))]
    rows = {
        "frame_token": list(tokens),
        "stamp_ns": [10**18 + round(place_m * 1e9) for place_m in places_m],
        **{"x_m": places_m, "y_m": [0.0] * len(tokens), "z_m": [0.0] * len(tokens)},
    }
    told = json.dumps({"vehicle": "n1", "map_origin_deg_m": [37.0, 127.0, 50.0]} | about)
    pq.write_table(pa.table(rows).replace_schema_metadata({"stone": told}), folder / TABLE)


def test_label_sets_that_continue_each_other_are_one_drive_of_a_local_score(tmp_path: Path) -> None:
    """Three of one run, by their places; two of another vehicle, whose odometry is not on the earth; one alone."""
    names = ("a", "b", "c", "d", "e", "f")
    tokens = {name: tuple(f"{ord(name) * 1000 + at:032x}" for at in range(3)) for name in names}
    begin_m = {"a": 0.6, "b": 0.0, "c": 0.3, "d": 5000.3, "e": 5000.0, "f": 9000.0}
    for name, listed in tokens.items():
        other = {"vehicle": "n2", "map_origin_deg_m": None} if name in "de" else {}
        write_track(tmp_path / "gts" / name, listed, begin_m[name], **other)
        for token in listed:
            (tmp_path / "gts" / name / token).mkdir()
            (tmp_path / "gts" / name / token / "labels.npz").write_bytes(npz_bytes({"semantics": speckled(ord(name))}))
    timed = in_time_order(tmp_path / "gts", tokens)
    assert timed is not None
    assert {name: one.drive for name, one in timed.items()} == dict(zip("abcdef", (*"bbbee", None), strict=True))
    write_submission(tmp_path / "sub.zip", ((token, speckled(1)) for listed in tokens.values() for token in listed))
    record = score(tmp_path / "sub.zip", tmp_path, order=in_time_order).as_record()
    assert {name: part["frames"] for name, part in record["by"]["drive"].items()} == {"b": 9, "e": 6, "f": 3}
    assert set(record["silences"]["new_place"].values()) == {"few_sequences"}, "three drives are too few"
    alone = {name: replace(one, drive=None) for name, one in timed.items()}
    apart = score(tmp_path / "sub.zip", tmp_path, order=lambda *_: alone)
    assert "few_sequences" not in apart.as_record()["silences"]["new_place"].values(), "six sequences would be enough"


def test_a_published_dataset_is_ordered_and_its_drives_are_known_by_its_tables(tmp_path: Path) -> None:
    what = ReleasedDataset(scenes=4, frames=3, layout=LAYOUTS["paper"])
    write_released(tmp_path, what)
    names = what.tables.names
    by_name = {name: sorted(what.tables.tokens(scene)) for scene, name in enumerate(names)}
    timed = in_time_order(tmp_path / "gts", by_name)
    assert tokens_of(timed) == {name: what.tables.tokens(scene) for scene, name in enumerate(names)}
    assert timed is not None
    assert [one.drive for one in timed.values()] == [names[0], names[0], names[2], names[2]]
    assert [one.first_stamp_ns for one in timed.values()] == [
        1000 * what.tables.stamp_us(scene, 0) for scene in range(4)
    ]


def test_a_frame_in_no_table_leaves_the_order_unknown(tmp_path: Path) -> None:
    assert in_time_order(tmp_path / "gts", SEQUENCES) is None
    write_table(tmp_path / "gts" / "north", SEQUENCES["north"])
    write_table(tmp_path / "gts" / "south", SEQUENCES["south"][1:])
    assert in_time_order(tmp_path / "gts", SEQUENCES) is None


def test_a_table_that_cannot_be_read_or_has_no_stamps_is_named(tmp_path: Path) -> None:
    pq.write_table(pa.table({"frame_token": list(TOKENS)}), tmp_path / "without_stamps")
    write_track(tmp_path / "badly_placed", TOKENS, 0.0, map_origin_deg_m=[1, "x"])
    bad = [tmp_path / "without_stamps", tmp_path / "badly_placed" / TABLE]
    for content in (b"", b"PAR1" + bytes(40) + b"PAR1", *(path.read_bytes() for path in bad)):
        (tmp_path / TABLE).write_bytes(content)
        with pytest.raises(GroundTruthError, match=TABLE):
            in_time_order(tmp_path / "gts", SEQUENCES)


def test_without_the_order_no_interval_of_these_places_is_told(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    record = score(tmp_path / "sub.zip", world.folder, order=in_time_order).as_record()
    assert record["intervals"]["these_places"] == dict.fromkeys(RATIOS)
    assert record["silences"]["these_places"] == dict.fromkeys(RATIOS, "unknown_order")
    assert set(record["silences"]["new_place"].values()) == {"few_sequences"}


def test_with_the_order_the_score_is_the_same_and_its_frames_stand_in_time(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    shutil.copytree(world.folder, tmp_path / "truth")
    tokens = tuple(sorted(world.labels, reverse=True))
    write_table(tmp_path / "truth", tokens)
    ordered = find_ground_truth(tmp_path / "truth", order=in_time_order)
    for listed in ordered.manifest.sequences.values():
        assert list(listed) == [token for token in tokens if token in listed]
    submission = tmp_path / "sub.zip"
    record = score(submission, ordered.folder, order=in_time_order).as_record()
    without = score(submission, world.folder, order=in_time_order).as_record()
    assert "unknown_order" not in record["silences"]["these_places"].values()
    assert record["total"] == without["total"]
    assert record["signature"] == without["signature"]


def test_the_same_submission_is_the_same_bytes(world: World, submission: Path, tmp_path: Path) -> None:
    write_submission(tmp_path / "again.zip", world.predictions.items())
    assert (tmp_path / "again.zip").read_bytes() == submission.read_bytes()
