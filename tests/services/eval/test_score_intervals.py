"""The intervals of a record are those of the science, each beside the reason where there is none."""

import io

import numpy as np
import pytest
from numpy.typing import NDArray

from services.eval.score_intervals import interval_record, spectra_npz, spectra_of
from stone.errors import ShapeError
from stone.scoring.confusion import named_ratios
from stone.scoring.intervals import Estimate, estimates
from stone.scoring.metric import METRIC_VERSION, METRICS, RATIOS
from stone.scoring.silences import SCOPES

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
    with pytest.raises(ShapeError, match="influences has shape"):
        spectra_of(confusions_of(0, 9), (4, 4), CURRENT)
