"""The golden vectors that everybody may have are what both of our ways say: the fast kernels and the slow metric."""

import json
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from services.domain.benchmarks.golden import golden_archive, golden_file, golden_names
from services.eval.pipeline import score
from stone.scoring.confusion import named_ratios
from stone.scoring.metric import METRICS, RATIOS
from stone_submissions.ground_truth import Mask
from stone_submissions.validation import validate
from stone_submissions.verdict import SubmissionRefusedError
from tests.golden_vectors import MASKS, expected, files, read

MAX_BYTES = 300_000


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files as a user unpacks them."""
    folder = tmp_path_factory.mktemp("golden")
    with zipfile.ZipFile(BytesIO(golden_archive())) as archive:
        archive.extractall(folder)
    return folder


@pytest.fixture(scope="module")
def said() -> Any:
    return json.loads(golden_file("expected.json"))


@pytest.mark.parametrize("mask", MASKS)
def test_the_kernels_count_the_golden_frames(golden: Path, said: Any, mask: Mask) -> None:
    tally = score(golden / "submission.zip", golden, mask=mask).counts_of_frames
    assert tally.column_counts is not None
    tokens = [path.parent.name for path in sorted(golden.glob("gts/*/*/labels.npz"))]
    counted = {
        token: {
            "confusion": tally.confusions[index].tolist(),
            "bev": tally.bev[index].tolist(),
            "pairs": tally.column_counts.pairs[index].tolist(),
            "columns": tally.column_counts.columns[index].tolist(),
        }
        for index, token in enumerate(tokens)
    }
    assert counted == said["masks"][mask]["frames"]


@pytest.mark.parametrize("mask", MASKS)
def test_every_metric_reads_the_golden_ratios(golden: Path, said: Any, mask: Mask) -> None:
    tally = score(golden / "submission.zip", golden, mask=mask).counts_of_frames
    total = tally.cells().sum(axis=(0, 1))
    cells = dict(zip((facts.name for facts in tally.sequences), tally.cells().sum(axis=1), strict=True))
    parts = [(total, said["masks"][mask]["total"])]
    parts += [(cells[name], part) for name, part in said["masks"][mask]["sequences"].items()]
    for confusion, part in parts:
        assert confusion.tolist() == part["confusion"]
        assert set(part["metrics"]) == set(METRICS)
        for metric, ratios in part["metrics"].items():
            found = named_ratios(confusion, metric)
            assert {name: value is None for name, value in ratios.items()} == {n: found[n] is None for n in RATIOS}
            assert [found[name] or 0 for name in RATIOS] == pytest.approx([ratios[n] or 0 for n in RATIOS], rel=1e-15)
    record = score(golden / "submission.zip", golden, mask=mask).as_record()
    for part in ("extras", "tolerant", "columns"):
        assert record[part] == pytest.approx(said["masks"][mask]["total"][part], rel=1e-15)


def test_unknown_written_as_255_is_refused_as_the_vectors_say(golden: Path, said: Any) -> None:
    refused = said["refused"]
    found = validate(golden / refused["file"], golden / "manifest.json")
    assert [(problem.code, problem.frame) for problem in found.errors] == [(refused["code"], refused["frame"])]
    with pytest.raises(SubmissionRefusedError, match=r"1 problems; .*255"):
        score(golden / refused["file"], golden)


@pytest.mark.whole
def test_the_slow_metric_makes_the_same_vectors_again(said: Any) -> None:
    made = files()
    kept = {name: golden_file(name) for name in golden_names()}
    assert expected({name: kept[name] for name in made}) == said
    assert set(made) | {"expected.json", "README.md"} == set(kept)
    for name, content in made.items():
        assert contents(content, name) == contents(kept[name], name), name


def test_the_archive_is_small_and_holds_every_file() -> None:
    assert len(golden_archive()) < MAX_BYTES
    with pytest.raises(KeyError):
        golden_file("../__init__.py")


def contents(content: bytes, name: str) -> Any:
    """What a file says, whatever zlib packed it."""
    if name.endswith(".npz"):
        return {key: array.tobytes() for key, array in read(content).items()}
    if name.endswith(".zip"):
        with zipfile.ZipFile(BytesIO(content)) as archive:
            return {member: contents(archive.read(member), member) for member in archive.namelist()}
    return content
