"""A pack gives back what was put in, any part of it alone, and names the same ground truth as `stone score` does."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.eval.ground_truth import read_truth
from services.eval.pipeline import score
from services.eval.truth_pack import TRAILER, PackSummary, TruthPack, TruthPackError, write_truth_pack
from stone.scoring.frame_counts import TruthPlanes
from stone.sensors.sequence import NAME
from stone_submissions.errors import GroundTruthError, UnreadableInputError
from stone_submissions.ground_truth import Mask, find_ground_truth
from stone_submissions.manifest import Manifest, read_manifest, write_manifest
from testing.refusals import refused_as
from testing.worlds.submission_files import write_submission
from tests.golden_vectors import MASKS
from tests.services.eval.conftest import World


def packed(world: World, path: Path, mask: Mask = "all", threads: int = 2) -> PackSummary:
    truth = find_ground_truth(world.folder, mask)
    paths = truth.paths()
    return write_truth_pack(path, truth.manifest, lambda token: read_truth(paths[token], mask), threads=threads)


@pytest.fixture
def pack(world: World, tmp_path: Path) -> Iterator[TruthPack]:
    packed(world, tmp_path / "truth.pack")
    with TruthPack(tmp_path / "truth.pack") as opened:
        yield opened


@pytest.mark.parametrize("mask", MASKS)
def test_the_pack_names_the_ground_truth_as_a_score_does(world: World, tmp_path: Path, mask: Mask) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    signature = score(tmp_path / "sub.zip", world.folder, mask=mask).signature
    assert packed(world, tmp_path / "truth.pack", mask) == PackSummary(signature.ground_truth, 3)


@pytest.mark.parametrize("mask", MASKS)
def test_every_frame_comes_back_whole(world: World, tmp_path: Path, mask: Mask) -> None:
    packed(world, tmp_path / "truth.pack", mask)
    truth = find_ground_truth(world.folder, mask)
    with TruthPack(tmp_path / "truth.pack") as pack:
        assert pack.tokens == truth.manifest.tokens
        for index, (token, path) in enumerate(truth.paths().items()):
            expected = read_truth(path, mask)
            for found in (pack.planes(index), pack.planes_of(token)):
                np.testing.assert_array_equal(found.planes, expected.planes)
                np.testing.assert_array_equal(found.counts, expected.counts)


def test_the_same_ground_truth_is_the_same_bytes(world: World, tmp_path: Path) -> None:
    for name, threads in (("a", 1), ("b", 3)):
        packed(world, tmp_path / name, threads=threads)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_name_of_a_ground_truth_does_not_depend_on_the_order_of_frames(pack: TruthPack, tmp_path: Path) -> None:
    backwards = Manifest({"all": tuple(reversed(pack.tokens))})
    forwards = Manifest({"all": pack.tokens})
    summaries = [write_truth_pack(tmp_path / "p", manifest, pack.planes_of) for manifest in (forwards, backwards)]
    assert summaries[0] == summaries[1]


def test_threads_read_at_once_what_one_reads(pack: TruthPack) -> None:
    alone = [pack.planes(index).planes for index in range(3)]
    with ThreadPoolExecutor(4) as pool:
        for index, planes in zip(list(range(3)) * 8, pool.map(pack.planes, list(range(3)) * 8), strict=True):
            np.testing.assert_array_equal(planes.planes, alone[index])


def test_a_pack_that_cannot_be_made_leaves_nothing(world: World, tmp_path: Path) -> None:
    def broken(token: str) -> TruthPlanes:
        raise GroundTruthError(tmp_path / token, "lost")

    with pytest.raises(GroundTruthError):
        write_truth_pack(tmp_path / "p", find_ground_truth(world.folder).manifest, broken)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", [0.1, 0.5, 0.9])
def test_a_changed_byte_is_noticed(world: World, tmp_path: Path, place: float) -> None:
    packed(world, tmp_path / "p")
    raw = bytearray((tmp_path / "p").read_bytes())
    with TruthPack(tmp_path / "p") as pack:
        end = int(pack._offsets[-1])
    raw[8 + int(place * (end - 8))] ^= 4
    (tmp_path / "p").write_bytes(raw)
    with TruthPack(tmp_path / "p") as pack, pytest.raises(TruthPackError):
        list(map(pack.planes, range(3)))


def test_what_is_no_pack_is_refused(world: World, tmp_path: Path) -> None:
    packed(world, tmp_path / "whole")
    whole = (tmp_path / "whole").read_bytes()
    broken = {
        "empty": b"",
        "short": whole[:-1],
        "no index": whole[: -TRAILER.size - 40] + whole[-TRAILER.size :],
        "index beyond": whole[: -TRAILER.size] + TRAILER.pack(2**63, whole[-8:]),
    }
    for name, content in broken.items():
        (tmp_path / "p").write_bytes(content)
        with pytest.raises(TruthPackError):
            TruthPack(tmp_path / "p")
        assert name
    with pytest.raises(UnreadableInputError):
        TruthPack(tmp_path / "absent")


TOKEN = "0123456789abcdef" * 2


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.from_regex(NAME, fullmatch=True), st.integers(1, 3), min_size=1, max_size=4))
def test_a_manifest_survives_the_disk(tmp_path: Path, sizes: dict[str, int]) -> None:
    path = tmp_path / "manifest.json"
    tokens = iter(f"{index:032x}" for index in range(100))
    manifest = Manifest({name: tuple(next(tokens) for _ in range(size)) for name, size in sizes.items()})
    write_manifest(path, manifest)
    assert read_manifest(path) == manifest


def test_the_manifest_of_a_ground_truth_lists_its_folders(world: World) -> None:
    manifest = find_ground_truth(world.folder).manifest
    assert {name: len(tokens) for name, tokens in manifest.sequences.items()} == {"north": 2, "south": 1}
    assert set(manifest.tokens) == set(world.labels)
    assert read_manifest(world.manifest_path) == manifest


@pytest.mark.parametrize(
    "text",
    [
        "<html>",
        "[" * 100_000,
        "[]",
        json.dumps({"stone_manifest": 2, "sequences": {"s": [TOKEN]}}),
        " " * (8 * 2**20 + 1),
        *(
            json.dumps({"stone_manifest": 1, "sequences": sequences})
            for sequences in (
                [TOKEN],
                {"s": "x"},
                {"s": ["../../etc/passwd"]},
                {"s": [TOKEN.upper()]},
                {"s": [{}]},
                {"../s": [TOKEN]},
                {"a b": [TOKEN]},
                {"\u202eevil": [TOKEN]},
                {"s" * 101: [TOKEN]},
                {"s": []},
                {"s": [TOKEN, TOKEN]},
            )
        ),
    ],
)
def test_a_broken_manifest_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    path.write_text(text)
    with refused_as("bad_manifest"):
        read_manifest(path)


def test_an_absent_manifest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInputError):
        read_manifest(tmp_path / "m.json")
