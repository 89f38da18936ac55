"""A manifest survives the disk; anything else under its name is refused with its reason."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.eval.ground_truth import find_ground_truth
from stone.sensors.sequence import NAME
from stone_submissions.errors import ManifestError, UnreadableInputError
from stone_submissions.manifest import Manifest, read_manifest, write_manifest
from tests.services.eval.conftest import World

TOKEN = "0123456789abcdef" * 2


@given(st.dictionaries(st.from_regex(NAME, fullmatch=True), st.integers(1, 3), min_size=1, max_size=4))
def test_a_manifest_survives_the_disk(tmp_path_factory: pytest.TempPathFactory, sizes: dict[str, int]) -> None:
    path = tmp_path_factory.mktemp("m") / "manifest.json"
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
    ("text", "fault"),
    [
        ("<html>", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "expected an object with stone_manifest 1"),
        (json.dumps({"stone_manifest": 2, "sequences": {"s": [TOKEN]}}), "stone_manifest 1"),
        (json.dumps({"stone_manifest": 1, "sequences": [TOKEN]}), "list of frame tokens"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": "x"}}), "list of frame tokens"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": ["../../etc/passwd"]}}), "frame token '../../etc/passwd'"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": [TOKEN.upper()]}}), "frame token"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": [{}]}}), "frame token"),
        (json.dumps({"stone_manifest": 1, "sequences": {"../s": [TOKEN]}}), "sequence name '../s'"),
        (json.dumps({"stone_manifest": 1, "sequences": {"a b": [TOKEN]}}), "sequence name 'a b'"),
        (json.dumps({"stone_manifest": 1, "sequences": {"\u202eevil": [TOKEN]}}), "sequence name"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s" * 101: [TOKEN]}}), "sequence name"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": []}}), "0 frames"),
        (json.dumps({"stone_manifest": 1, "sequences": {"s": [TOKEN, TOKEN]}}), "occurs twice"),
        (" " * (8 * 2**20 + 1), "larger than 8388608 bytes"),
    ],
)
def test_a_broken_manifest_is_refused(text: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    path.write_text(text)
    with pytest.raises(ManifestError, match=fault):
        read_manifest(path)


def test_an_absent_manifest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInputError, match=r"m\.json cannot be read: No such file"):
        read_manifest(tmp_path / "m.json")
