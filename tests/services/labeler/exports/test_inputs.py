"""What participants are given of a hidden sequence: all the sensors said, and no byte that comes from a label."""

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from services.labeler.exports.folder import ExportRequest, export
from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.sandboxed_export import write_inputs
from services.labeler.exports.source import LabelledSequence
from tests.services.labeler.exports.made import Labelled, files_of, unheard


def unlabelled(source: LabelledSequence) -> LabelledSequence:
    """The same recording as if nobody had labelled it: whoever looks at a label fails."""

    def refuse(index: int) -> bytes:
        raise AssertionError(f"the labels of frame {index} were asked for")

    nowhere = Path("/nowhere")
    return replace(source, labels=refuse, report={}, mesh=nowhere / "mesh.ply", frames_table=nowhere / "frames.parquet")


@pytest.fixture(scope="module")
def out(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(drive.source(), folder, unheard)
    return folder


def rows(content: bytes) -> list[dict[str, Any]]:
    read: list[dict[str, Any]] = json.loads(content)
    return read


def test_inputs_are_the_same_whatever_the_labels_are(drive: Labelled, out: Path, tmp_path: Path) -> None:
    write_inputs(unlabelled(drive.source()), tmp_path, unheard)
    assert files_of(tmp_path) == files_of(out)


def test_inputs_are_the_release_layout_without_labels(drive: Labelled, out: Path, tmp_path: Path) -> None:
    write_nuscenes(drive.source(), tmp_path, unheard)
    release, inputs = files_of(tmp_path), files_of(out)
    assert set(inputs) == {name for name in release if not name.startswith("gts/")}
    differing = {name for name in inputs if inputs[name] != release[name]}
    (mask,) = (name for name in release if name.startswith("maps/"))
    assert mask in differing
    # where a mesh reaches farther than one sees from the path, these are shifted by other metres
    shifted = {mask, "v1.0-trainval/ego_pose.json", "v1.0-trainval/log.json"}
    assert differing - shifted == {"v1.0-trainval/scene.json"}
    assert b"quality" not in inputs["v1.0-trainval/scene.json"]
    for token, grids in ((token, drive.source().grids(index)) for index, token in enumerate(tokens(drive))):
        labels = release[f"gts/drive/{token}/labels.npz"]
        assert grids["semantics"].any()
        assert not any(labels in content for content in inputs.values())


def tokens(drive: Labelled) -> tuple[str, ...]:
    return drive.source().sequence.frames.tokens


def test_samples_are_called_as_the_frames_are(drive: Labelled, out: Path) -> None:
    samples = rows((out / "v1.0-trainval" / "sample.json").read_bytes())
    assert tuple(row["token"] for row in samples) == tokens(drive)


def test_the_map_says_nothing_and_stands_where_the_robot_drove(drive: Labelled, out: Path) -> None:
    (mask,) = (content for name, content in files_of(out).items() if name.startswith("maps/"))
    with Image.open(io.BytesIO(mask)) as picture:
        assert not np.asarray(picture).any()
        size_m = np.array(picture.size) / 10
    low_m = -np.array(rows((out / "v1.0-trainval" / "log.json").read_bytes())[0]["global_from_map_m"][:2])
    driven_m = drive.source().sequence.frames.map_from_ego.translation_m[:, :2]
    assert (low_m == np.floor(driven_m.min(axis=0) - 60) - 1).all()
    assert (low_m + size_m == np.ceil(driven_m.max(axis=0) + 60) + 1).all()


def test_the_folder_of_several_sequences_tells_nothing_of_labels_either(drive: Labelled, tmp_path: Path) -> None:
    other = {**drive.report, "class_share_of_occupied": {"T": 1.0}, "reference": {}, "map": {}}
    for name, report in (("this", drive.report), ("other", other)):
        export(ExportRequest("inputs", tmp_path / name, report), drive.source, unheard)
    assert files_of(tmp_path / "this") == files_of(tmp_path / "other")
