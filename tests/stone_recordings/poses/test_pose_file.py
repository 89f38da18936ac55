"""Files of poses: what TUM and KITTI mean, and every way in which a file is none, with its line."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import StoneError
from stone.geometry.se3 import SE3
from stone_recordings.poses import file_poses
from stone_recordings.poses.file_poses import read_pose_file
from testing.refusals import refused_as
from testing.worlds.pose_files import kitti_text, tum_text

GOOD = "1700000000.1 1 2 3 0 0 0 1\n"
EYE = "1 0 0 0 0 1 0 0 0 0 1 0\n"


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_tum_keeps_every_digit_of_a_time_and_leaves_comments_out(tmp_path: Path) -> None:
    text = f"# time x y z qx qy qz qw\n\n1700000000.123456789 1 2 3 0 0 0 1 # first\n{GOOD.replace('.1', '.2')}"
    read = read_pose_file(written(tmp_path / "a.txt", text))
    assert read.format == "TUM"
    assert read.stamps_ns is not None
    assert read.stamps_ns.tolist() == [1_700_000_000_123_456_789, 1_700_000_000_200_000_000]
    np.testing.assert_allclose(read.poses.translation_m, [[1, 2, 3]] * 2)
    assert read.sha256 == sha256(text.encode()).hexdigest()


@given(seed=st.integers(0, 2**31), count=st.integers(1, 20))
@settings(max_examples=20)
def test_what_was_written_is_read_again(tmp_path_factory: pytest.TempPathFactory, seed: int, count: int) -> None:
    rng, path = np.random.default_rng(seed), tmp_path_factory.mktemp("poses") / "poses.txt"
    wxyz = rng.normal(size=(count, 4))
    poses = SE3.from_parts(wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True), rng.normal(0, 1e4, (count, 3)))
    stamps_ns = 1_700_000_000_000_000_000 + np.cumsum(rng.integers(1, 10**9, count))
    tum = read_pose_file(written(path, tum_text(stamps_ns, poses)))
    assert tum.stamps_ns is not None
    assert tum.stamps_ns.tolist() == stamps_ns.tolist()
    kitti = read_pose_file(written(path, kitti_text(poses)))
    assert (kitti.format, kitti.stamps_ns) == ("KITTI", None)
    for read in (tum, kitti):
        np.testing.assert_allclose(read.poses.as_matrix(), poses.as_matrix(), atol=1e-9)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", 0), ("# nothing\n", 0), ("1 2 3\n", 1), (GOOD + EYE, 2), ("#\n" + GOOD.replace("3", "three"), 2),
        (GOOD.replace(" 3 ", " nan "), 1), (GOOD.replace("1700000000.1", "1_7"), 1),
        (GOOD.replace("1700000000.1", "1700000000123456789"), 1), (GOOD.replace("1700000000.1", "-5"), 1),
        (GOOD + "\n" + GOOD, 3), (GOOD.replace(" 3 ", " 3e9 "), 1), (GOOD.replace("0 0 0 1", "0 0 0 2"), 1),
        (GOOD.replace("0 0 0 1", "0 0 0 0"), 1), (GOOD.replace("0 0 0 1", "0 0 0 1e200"), 1),
        (EYE + EYE.replace("1", "2", 1), 2), (EYE.replace("1", "-1", 1), 1), (EYE.replace("0", "1e200", 1), 1),
        ("1 " * 600, 1), ("\x00\x01" * 20, 1),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_refused_with_its_line(tmp_path: Path, text: str, line: int) -> None:
    with refused_as("SYN-516") as refused:
        read_pose_file(written(tmp_path / "p.txt", text))
    assert not line or f"line {line}: " in str(refused.value)


def test_a_file_that_is_no_text_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "p.txt"
    path.write_bytes(b"\xff\xd8\xff\xe0 a picture\n")
    with refused_as("SYN-516"):
        read_pose_file(path)
    monkeypatch.setattr(file_poses, "MOST_POSES", 1)
    with refused_as("SYN-516"):
        read_pose_file(written(path, EYE * 2))
    monkeypatch.setattr(file_poses, "LARGEST_BYTES", 10)
    with refused_as("SYN-516"):
        read_pose_file(written(path, EYE))


@given(content=st.binary(max_size=400))
@settings(max_examples=100)
def test_any_bytes_are_poses_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_bytes(content)
    try:
        read_pose_file(path)
    except StoneError as error:
        if error.code != "SYN-516":
            raise
