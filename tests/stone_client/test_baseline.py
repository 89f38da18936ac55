"""`stone baseline` from exports of every kind: what the recording gives, the same bytes, hostile data refused.

Catches alone a baseline that differs by the export it is made from.
"""

import io
import json
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from services.ingest.sequence import open_sequence
from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.sandboxed_export import write_inputs
from stone.labels.baseline import predict_from_sweep
from stone_client.sdk import Stone
from stone_submissions.manifest import Manifest, write_manifest
from testing.worlds.submission_files import write_submission
from tests.services.labeler.exports.conftest import drive
from tests.services.labeler.exports.made import Labelled, unheard
from tests.stone_client.participating import refused, stone

pytestmark = pytest.mark.whole

__all__ = ["drive"]  # a fixture


@pytest.fixture(scope="module")
def inputs(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(drive.source(), folder, unheard)
    return folder


@pytest.fixture
def tokens(drive: Labelled) -> tuple[str, ...]:
    return drive.source().sequence.frames.tokens


@pytest.fixture
def manifest(tmp_path: Path, tokens: tuple[str, ...]) -> Path:
    """Not in the order of time: a submission has the manifest's."""
    write_manifest(tmp_path / "M.json", Manifest({"drive": tokens[::-1]}))
    return tmp_path / "M.json"


def made(output: Path, manifest: Path, *sources: Path, workers: int = 2, sweeps: int = 1) -> bytes:
    counts = ("--workers", str(workers), "--sweeps", str(sweeps))
    result = stone("baseline", *sources, "--manifest", manifest, "-o", output, *counts, "--json")
    assert result.exit_code == 0, (result.stderr, result.exception)
    said = json.loads(result.stdout)
    assert said["size_bytes"] == output.stat().st_size
    return output.read_bytes()


def recorded_predictions(bag: Path) -> dict[str, NDArray[np.uint8]]:
    """Of each frame by token, from the recording itself: no export, no table, no thread."""
    sequence, sweeps = open_sequence(bag, bag.with_suffix(".calibration.yaml"), "drive")
    ego_from_lidar = sequence.calibration.ego_from_lidar
    found = {}
    for index, token in enumerate(sequence.frames.tokens):
        points_ego = ego_from_lidar @ sweeps.sweep(index).points_lidar.astype(np.float64)
        found[token] = predict_from_sweep(points_ego.astype(np.float32))
    return found


def test_it_is_what_the_recording_gives_whatever_it_is_made_from(
    drive: Labelled, inputs: Path, manifest: Path, tmp_path: Path
) -> None:
    frames = recorded_predictions(drive.bag)
    write_submission(tmp_path / "recorded.zip", reversed(frames.items()))
    wanted = (tmp_path / "recorded.zip").read_bytes()
    assert len({grid.tobytes() for grid in frames.values()}) > 1
    export(ExportRequest("nuscenes", tmp_path / "release", drive.report), drive.source, unheard)
    with tarfile.open(tmp_path / "inputs.tar", "w") as tar:
        tar.add(inputs, ".")
    with tarfile.open(tmp_path / "below.tar", "w") as tar:
        tar.add(inputs, "some/folder")
    for source in (inputs, tmp_path / "release", tmp_path / "inputs.tar", tmp_path / "below.tar"):
        assert made(tmp_path / "sub.zip", manifest, source) == wanted, source
    assert made(tmp_path / "sub.zip", manifest, inputs, workers=1) == wanted


def test_earlier_sweeps_and_the_track_are_those_of_the_recording(
    drive: Labelled, inputs: Path, manifest: Path, tmp_path: Path
) -> None:
    sequence, sweeps = open_sequence(drive.bag, drive.bag.with_suffix(".calibration.yaml"), "drive")
    poses, found = sequence.frames.map_from_ego, {}
    for index, token in enumerate(sequence.frames.tokens):
        ego_from_map = poses[index].inverse()
        points = [
            ego_from_map
            @ (poses[at] @ (sequence.calibration.ego_from_lidar @ sweeps.sweep(at).points_lidar.astype("f8")))
            for at in range(max(0, index - 2), index + 1)
        ]
        track = ego_from_map @ poses[np.arange(index)].translation_m
        found[token] = predict_from_sweep(np.concatenate(points).astype(np.float32), track_ego_m=track[:, :2])
    with zipfile.ZipFile(io.BytesIO(made(tmp_path / "sub.zip", manifest, inputs, sweeps=3))) as written:
        for name in written.namelist():
            grid = np.load(io.BytesIO(written.read(name)))["semantics"]
            is_other = grid != found[name.rpartition("/")[2].removesuffix(".npz")]
            assert is_other.mean() < 1e-4, name  # a float32 that fell on the other side of a voxel's border


def test_python_writes_the_same(inputs: Path, manifest: Path, tmp_path: Path) -> None:
    with Stone("http://127.0.0.1:1", "no server is asked") as api:
        written = api.baseline([inputs], manifest, tmp_path / "python.zip")
    assert written.read_bytes() == made(tmp_path / "sub.zip", manifest, inputs)


def renamed(inputs: Path, folder: Path, rename: Callable[[str], str]) -> Path:
    """The same inputs as if the sequence and its frames were called otherwise."""
    copytree(inputs, folder)
    for name in ("sample", "sample_data"):
        table = folder / "v1.0-trainval" / f"{name}.json"
        rows = json.loads(table.read_text())
        for row in rows:
            key = "token" if name == "sample" else "sample_token"
            row[key] = rename(row[key])
        table.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    return folder


def test_several_sequences_are_one_submission(inputs: Path, tokens: tuple[str, ...], tmp_path: Path) -> None:
    def rename(token: str) -> str:
        return token[::-1]

    (tmp_path / "all").mkdir()
    renamed(inputs, tmp_path / "all" / "quarry", rename)
    with tarfile.open(tmp_path / "all" / "drive.tar", "w") as tar:
        tar.add(inputs, ".")
    both = {"drive": tokens, "quarry": tuple(map(rename, tokens))}
    write_manifest(tmp_path / "M.json", Manifest(both))
    apart = made(tmp_path / "a.zip", tmp_path / "M.json", tmp_path / "all" / "drive.tar", tmp_path / "all" / "quarry")
    assert made(tmp_path / "b.zip", tmp_path / "M.json", tmp_path / "all") == apart
    lacking = stone("baseline", inputs, "--manifest", tmp_path / "M.json", "-o", tmp_path / "c.zip")
    assert refused(lacking) == "frames_missing"
    assert f"{len(tokens)} frames of the manifest" in lacking.stderr
    assert "quarry" in lacking.stderr
    assert not (tmp_path / "c.zip").exists()


def test_memory_does_not_grow_with_the_frames(inputs: Path, tokens: tuple[str, ...], tmp_path: Path) -> None:
    """A few frames are ahead of the writer, however many there are: 12 grids alone would be 24 MiB."""
    write_manifest(tmp_path / "M.json", Manifest({"drive": tokens}))
    made(tmp_path / "sub.zip", tmp_path / "M.json", inputs, workers=1)
    tracemalloc.start()
    made(tmp_path / "sub.zip", tmp_path / "M.json", inputs, workers=1)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 20 * 2**20


def spoilt(inputs: Path, folder: Path, table: str, change: Callable[[list[dict[str, Any]]], object]) -> Path:
    copytree(inputs, folder)
    path = folder / "v1.0-trainval" / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n")
    return folder


def lidar(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return next(row for row in rows if "LIDAR_TOP" in row.get("filename", "LIDAR_TOP"))


ATTACKS: dict[str, tuple[str, Callable[[list[dict[str, Any]]], object]]] = {
    "a path elsewhere": ("sample_data", lambda rows: lidar(rows).update(filename="../../../etc/passwd")),
    "a file that is no sweep": ("sample_data", lambda rows: lidar(rows).update(filename="v1.0-trainval/log.json")),
    "a rotation that scales": ("calibrated_sensor", lambda rows: lidar(rows).update(rotation=[2, 0, 0, 0])),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_tables_that_lie_are_refused(inputs: Path, manifest: Path, tmp_path: Path, attack: str) -> None:
    folder = spoilt(inputs, tmp_path / "spoilt", *ATTACKS[attack])
    result = stone("baseline", folder, "--manifest", manifest, "-o", tmp_path / "sub.zip")
    assert refused(result) == "damaged_export"
    assert not (tmp_path / "sub.zip").exists()


def test_a_table_that_is_none_is_refused(inputs: Path, manifest: Path, tmp_path: Path) -> None:
    for name, content in [
        ("sample_data", b"[\n" + b"[" * 100_000),
        ("sample_data", b"[\n{]\n"),
        ("sample_data", b"[\n1,\n2]\n"),
        ("sample_data", b'[{"a": "' + b"x" * 3 * 2**20),
        ("sensor", b"\xff\xfe\n"),
    ]:
        copytree(inputs, tmp_path / "spoilt", dirs_exist_ok=True)
        (tmp_path / "spoilt" / "v1.0-trainval" / f"{name}.json").write_bytes(content)
        result = stone("baseline", tmp_path / "spoilt", "--manifest", manifest, "-o", tmp_path / "sub.zip")
        assert refused(result) == "damaged_export"


def test_a_sweep_that_is_too_large_or_cut_is_refused(inputs: Path, manifest: Path, tmp_path: Path) -> None:
    copytree(inputs, tmp_path / "spoilt")
    sweep = sorted((tmp_path / "spoilt" / "samples" / "LIDAR_TOP").iterdir())[3]
    for length in (1001, 2**40):
        with sweep.open("r+b") as file:
            file.truncate(length)
        result = stone("baseline", tmp_path / "spoilt", "--manifest", manifest, "-o", tmp_path / "sub.zip")
        assert refused(result) == "damaged_export"


def test_returns_that_are_no_numbers_change_nothing(inputs: Path, manifest: Path, tmp_path: Path) -> None:
    copytree(inputs, tmp_path / "odd")
    for sweep in (tmp_path / "odd" / "samples" / "LIDAR_TOP").iterdir():
        rows = np.fromfile(sweep, "<f4").reshape(-1, 5)
        odd = np.array([[np.nan] * 5, [np.inf, -np.inf, 0, 0, 0], [1e38, 1e38, 1e38, 0, 0]], "<f4")
        sweep.write_bytes(np.concatenate([rows, odd]).tobytes())
    assert made(tmp_path / "a.zip", manifest, tmp_path / "odd") == made(tmp_path / "b.zip", manifest, inputs)


def test_a_folder_or_file_that_is_no_export_is_refused(manifest: Path, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    assert refused(stone("baseline", tmp_path / "home", "--manifest", manifest, "-o", "x.zip")) == "not_an_export"
    (tmp_path / "page.tar").write_text("<!doctype html>" * 100)
    assert refused(stone("baseline", tmp_path / "page.tar", "--manifest", manifest, "-o", "x.zip")) == "bad_tar"
    with tarfile.open(tmp_path / "other.tar", "w") as tar:
        tar.add(manifest, "M.json")
    assert refused(stone("baseline", tmp_path / "other.tar", "--manifest", manifest, "-o", "x.zip")) == "not_an_export"
