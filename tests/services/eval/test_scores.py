"""The record of a score: its parts add up, names group, and nothing that no one knows is in it."""

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from services.eval.spectra_file import spectra_npz
from stone.errors import ShapeError
from stone.scoring.confusion import extras, named_ratios
from stone.scoring.intervals import SCOPES, Estimate, estimates
from stone.scoring.metric import METRIC_VERSION, METRICS, OCCUPIED_VERSION, RATIOS
from stone.scoring.score_record import (
    RING_NAMES,
    SequenceFacts,
    SubmissionCounts,
    interval_record,
    record_of,
    spectra_of,
)
from testing.refusals import refused_as

SEQUENCES = (
    SequenceFacts("hill", 4, "forest", "day"),
    SequenceFacts("lake", 2, "shore", "day"),
    SequenceFacts("pass", 3, "forest", None),
)
FRAMES = 9


def counts_of_frames(seed: int = 0) -> SubmissionCounts:
    random = np.random.default_rng(seed)
    confusions = random.integers(0, 5000, (FRAMES, 3, 4, 4)).astype(np.int32)
    return SubmissionCounts(confusions, random.integers(0, 5000, (FRAMES, 3, 3)).astype(np.int32), SEQUENCES)


def record(counts: SubmissionCounts, metric: str = METRIC_VERSION) -> dict[str, Any]:
    return record_of(counts, counts.spectra(metric), metric)


@pytest.mark.parametrize("metric", METRICS)
def test_the_whole_is_the_sum_of_all_counts(metric: str) -> None:
    counts = counts_of_frames()
    total = counts.confusions.sum(axis=(0, 1), dtype=np.int64)
    said = record(counts, metric)
    assert said["frames"] == FRAMES
    assert said["confusion"] == total.tolist()
    assert said["total"] == named_ratios(total, metric)
    assert said["within_occupied"] == named_ratios(total, OCCUPIED_VERSION)
    assert said["extras"] == vars(extras(total, counts.bev.sum(axis=(0, 1))))
    assert set(said["intervals"]) == set(said["silences"]) == set(SCOPES)


def test_every_breakdown_adds_up_to_what_it_breaks_down() -> None:
    said = record(counts_of_frames())
    assert list(said["by"]) == ["distance", "sequence", "environment", "illumination"]
    for what in ("sequence", "environment"):
        parts = said["by"][what].values()
        assert sum(part["frames"] for part in parts) == FRAMES
        assert {name: sum(part["support"][name] for part in parts) for name in said["support"]} == said["support"]
    rings = said["by"]["distance"]
    assert tuple(rings) == RING_NAMES == ("0-10m", "10-20m", "from-20m")
    assert [ring["frames"] for ring in rings.values()] == [FRAMES] * 3
    assert sum(ring["support"]["N"] for ring in rings.values()) == said["support"]["N"]


def test_a_condition_is_the_sum_of_its_sequences() -> None:
    counts = counts_of_frames()
    forest = np.concatenate([counts.confusions[:4], counts.confusions[6:]]).sum(axis=(0, 1), dtype=np.int64)
    part = record(counts)["by"]["environment"]["forest"]
    assert {name: part[name] for name in RATIOS} == named_ratios(forest)
    assert part["frames"] == 7


def test_what_nobody_said_of_a_sequence_is_no_part() -> None:
    assert list(record(counts_of_frames())["by"]["illumination"]) == ["day"]
    silent = tuple(replace(facts, environment=None, illumination=None) for facts in SEQUENCES)
    assert list(record(replace(counts_of_frames(), sequences=silent))["by"]) == ["distance", "sequence"]


def test_cells_are_the_confusions_of_each_sequence_and_ring() -> None:
    counts = counts_of_frames()
    cells = record(counts)["cells"]
    assert list(cells) == ["hill", "lake", "pass"]
    np.testing.assert_array_equal(cells["lake"], counts.confusions[4:6].sum(axis=0))


def test_the_record_is_json_without_nan() -> None:
    nothing = SubmissionCounts(np.zeros((FRAMES, 3, 4, 4), np.int32), np.zeros((FRAMES, 3, 3), np.int32), SEQUENCES)
    for counts in (counts_of_frames(), nothing):
        said = record(counts)
        assert json.loads(json.dumps(said, allow_nan=False)) == said
    assert set(record(nothing)["total"].values()) == set(record(nothing)["extras"].values()) == {None}


def test_frames_in_another_order_have_the_intervals_of_their_order_in_time() -> None:
    counts, random = counts_of_frames(), np.random.default_rng(5)
    order, sequences, start = list[int](), list[SequenceFacts](), 0
    for facts in SEQUENCES:
        places = random.permutation(facts.frames)
        order += (start + places).tolist()
        sequences.append(replace(facts, places=tuple(places.tolist())))
        start += facts.frames
    mixed = SubmissionCounts(counts.confusions[order], counts.bev[order], tuple(sequences))
    assert order != sorted(order)
    assert record(mixed) == record(counts)


def test_counts_beyond_32_bits_are_added_exactly() -> None:
    many = SubmissionCounts(
        np.full((FRAMES, 3, 4, 4), 2**31 - 1, np.int32), np.full((FRAMES, 3, 3), 2**31 - 1, np.int32), SEQUENCES
    )
    said = record(many)
    assert said["confusion"] == [[27 * (2**31 - 1)] * 4] * 4
    assert said["extras"] == {
        "n_predicted_t_ratio": 0.25,
        "n_predicted_drivable_ratio": 0.5,
        "t_predicted_n_ratio": 0.25,
        "bev_drivable_iou": pytest.approx(1 / 3),
        "clear_drivable_iou": None,
    }


def test_counts_of_an_earlier_version_say_nothing_of_columns() -> None:
    said = record(counts_of_frames())
    assert (said["tolerant"], said["columns"], said["extras"]["clear_drivable_iou"]) == (None, None, None)


def test_an_unknown_metric_has_no_record() -> None:
    spectra = counts_of_frames().spectra()
    for ask in (counts_of_frames().spectra, lambda metric: record_of(counts_of_frames(), spectra, metric)):
        with refused_as("unknown_metric"):
            ask("best")


LENGTHS = (410, 190, 230, 200, 300)
CURRENT = METRICS[METRIC_VERSION]


def confusions_of(seed: int, frames: int = sum(LENGTHS)) -> NDArray[np.int32]:
    return np.random.default_rng(seed).integers(1, 10_000, (frames, 3, 4, 4)).astype(np.int32)


@pytest.mark.parametrize("version", [one.version for one in METRICS.values() if one.successor is None])
def test_each_ratio_has_its_interval_or_its_silence(version: str) -> None:
    confusions = confusions_of(1)
    total = named_ratios(confusions.sum(axis=(0, 1), dtype=np.int64), version)
    spectra = spectra_of(confusions, LENGTHS, METRICS[version])
    said = interval_record(total, spectra, METRICS[version])
    values = np.array([total[name] for name in RATIOS])
    for scope in SCOPES:
        for name, found in zip(RATIOS, estimates(values, spectra, scope), strict=True):
            bounds, silence = said["intervals"][scope][name], said["silences"][scope][name]
            assert (bounds is None) == isinstance(found, str) == (silence is not None)
            if isinstance(found, Estimate):
                assert bounds == list(found.ratio_interval())
                assert bounds[0] < (total[name] or 0) < bounds[1]


@pytest.mark.parametrize("version", [one.version for one in METRICS.values() if one.successor is not None])
def test_of_a_metric_whose_intervals_are_withdrawn_none_is_told(version: str) -> None:
    confusions = confusions_of(1)
    total = named_ratios(confusions.sum(axis=(0, 1), dtype=np.int64), version)
    said = interval_record(total, spectra_of(confusions, LENGTHS, METRICS[version]), METRICS[version])
    for scope in SCOPES:
        assert said["intervals"][scope] == dict.fromkeys(RATIOS)
        assert said["silences"][scope] == dict.fromkeys(RATIOS, "withdrawn")


def test_an_undefined_total_is_said_to_be_so() -> None:
    confusions = confusions_of(2)
    confusions[..., 2, :], confusions[..., 2] = 0, 0
    total = named_ratios(confusions.sum(axis=(0, 1), dtype=np.int64))
    silences = interval_record(total, spectra_of(confusions, LENGTHS, CURRENT), CURRENT)["silences"]
    for scope in SCOPES:
        assert (silences[scope]["iou_p"], silences[scope]["miou"]) == ("undefined", "undefined")


def test_the_file_is_the_spectra_and_always_the_same() -> None:
    spectra = spectra_of(confusions_of(4), LENGTHS, CURRENT)
    file = spectra_npz(spectra)
    assert file == spectra_npz(spectra_of(confusions_of(4), LENGTHS, CURRENT))
    assert len(file) < 12_000
    with np.load(io.BytesIO(file)) as arrays:
        assert sorted(arrays) == ["coefficients", "frames_of_sequence", "sequence_weight", "spread"]
        assert arrays["frames_of_sequence"].tolist() == list(LENGTHS)
        np.testing.assert_allclose(arrays["coefficients"], spectra.coefficients, rtol=1e-6)


def test_lengths_that_do_not_add_up_are_refused() -> None:
    with pytest.raises(ShapeError):
        spectra_of(confusions_of(0, 9), (4, 4), CURRENT)


def test_sequences_of_one_drive_count_as_one_in_time_order_and_in_the_exact_test() -> None:
    """hill and pass are a drive, driven pass first: as if it had come as one sequence."""
    counts = counts_of_frames()
    hill, lake, last = SEQUENCES
    chunked = replace(
        counts,
        sequences=(
            replace(hill, drive="ridge", first_stamp_ns=20),
            lake,
            replace(last, drive="ridge", first_stamp_ns=10),
        ),
    )
    order = [*range(6, 9), *range(4), *range(4, 6)]
    whole = replace(counts, confusions=counts.confusions[order], sequences=(SequenceFacts("ridge", 7), lake))
    found, wanted = chunked.spectra(), whole.spectra()
    assert found.layout == wanted.layout
    np.testing.assert_array_equal(found.coefficients, wanted.coefficients)
    np.testing.assert_array_equal(found.sequence_weight, wanted.sequence_weight)
    by = record(chunked)["by"]
    assert {name: part["frames"] for name, part in by["drive"].items()} == {"ridge": 7, "lake": 2}
    assert list(by["sequence"]) == ["hill", "lake", "pass"]
