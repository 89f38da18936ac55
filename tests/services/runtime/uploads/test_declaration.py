"""What a client may say of a file."""

import pytest

from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.errors import BadMetadataError


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("", "the name of a file"),
        ("  ", "the name of a file"),
        ("..", "the name of a file"),
        ("a/b.mcap", "without folders"),
        ("..\\b.mcap", "without folders"),
        ("a\nb.mcap", "no control"),
        ("a\0b", "no control"),
        ("a\u202egnp.exe", "no control"),
        ("a\ud800", "no control"),
        ("a" * 256, "at most 255 bytes"),
        ("ä" * 128, "at most 255 bytes"),
    ],
)
def test_a_name_that_is_no_plain_file_name_is_refused(name: str, complaint: str) -> None:
    with pytest.raises(BadMetadataError, match=complaint):
        UploadDeclaration(name, "recording", 1)


@pytest.mark.parametrize("name", ["run.mcap", "Feldweg Süd 3.mcap", ".hidden", "走る.db3", "a" * 255])
def test_a_plain_name_is_kept_as_it_is(name: str) -> None:
    assert UploadDeclaration(name, "recording", 1).filename == name


@pytest.mark.parametrize("purpose", ["", "Recording", "avatar"])
def test_a_purpose_nobody_knows_is_refused(purpose: str) -> None:
    with pytest.raises(BadMetadataError, match="purpose is"):
        UploadDeclaration("a", purpose, 1)


@pytest.mark.parametrize("sha256", ["abc", "g" * 64, "A" * 64, "0" * 65])
def test_what_is_no_sha256_is_refused(sha256: str) -> None:
    with pytest.raises(BadMetadataError, match="sha256 is"):
        UploadDeclaration("a", "recording", 1, sha256=sha256)


@pytest.mark.parametrize("target", ["../etc", "a b", "x" * 65, "a\n"])
def test_what_is_no_id_is_refused_as_a_target(target: str) -> None:
    with pytest.raises(BadMetadataError, match="target_id is"):
        UploadDeclaration("a", "recording", 1, target)
