"""A profile survives its file; a file that is none is refused in one sentence."""

from pathlib import Path

import pytest

from stone_recordings.topics.profile_errors import BadProfileError, ProfileFileError
from stone_recordings.topics.profile_file import LARGEST_BYTES, read_profile, write_profile
from stone_recordings.topics.profiles import TopicProfile


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    profile = TopicProfile({"lidar": "/punkte: ü #1", "CAM_FRONT": "yes", "pose": "~"}, "rover 'x'")
    write_profile(tmp_path / "rover.yaml", profile)
    assert read_profile(tmp_path / "rover.yaml") == profile
    write_profile(tmp_path / "rover.yaml", TopicProfile())
    assert read_profile(tmp_path / "rover.yaml") == TopicProfile()


HEAD = b"stone_profile: 1\n"


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"", "does not begin"),
        (b"- a", "does not begin"),
        (b"stone_profile: 2\ntopics: {}", "does not begin"),
        (b"\xff\xfe\x00", "UTF-8"),
        (HEAD, "not names by role"),
        (HEAD + b"topics: {lidar: 3}", "not names by role"),
        (HEAD + b"topics: []", "not names by role"),
        (HEAD + b"topics: {}\nplattform: x", "unknown key 'plattform'"),
        (HEAD + b"topics: {}\nplatform: 3", "platform"),
        (HEAD + b"topics: &a {lidar: *a}", "aliases"),
        (HEAD + b"topics: !!python/object:os.system {}", "tag"),
        (HEAD + b"#" * LARGEST_BYTES, "more than 65536 bytes"),
    ],
)
def test_what_is_no_profile_is_refused(tmp_path: Path, content: bytes, fault: str) -> None:
    (tmp_path / "rover.yaml").write_bytes(content)
    with pytest.raises(ProfileFileError, match=fault):
        read_profile(tmp_path / "rover.yaml")


def test_a_part_there_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rover.yaml").write_bytes(HEAD + b"topics: {lidarr: /points}")
    with pytest.raises(BadProfileError, match="lidarr"):
        read_profile(tmp_path / "rover.yaml")
