"""A folder of a dataset is checked, and sent as the tar that it would make; what its layout tells is refused before."""

import gzip
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.runtime.platform import Platform
from services.runtime.uploads import upload_file as stored_file
from stone.errors import StoneError
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.datasets import dataset_name, hashed_dataset
from stone_client.files.tus import LocalContent, Purpose, upload_file
from stone_datasets.reading import check_dataset
from stone_files.archives import tar_members
from testing.api.serving import Person
from testing.refusals import refused_as
from testing.stone_serve import until
from testing.worlds.published_datasets import (
    VERSION,
    SyntheticDataset,
    made_labels,
    write_published,
    write_published_tar,
)
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from tests.stone_client.participating import quiet, stone

GOOD = SyntheticDataset(labels=(made_labels(1), made_labels(2)))
CLIENT = """
import sys
from pathlib import Path
import stone_client.files.tus
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.datasets import hashed_dataset
stone_client.files.tus.PIECE_BYTES = 2**16
with Api(Server(sys.argv[1], sys.argv[2])) as api:
    local = hashed_dataset(Path(sys.argv[3]), lambda *_: None)
    stone_client.files.tus.upload_file(api, local, stone_client.files.tus.Purpose("dataset"), lambda *_: None)
"""


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_published(tmp_path_factory.mktemp("published") / "field", GOOD)


def whole(local: LocalContent) -> bytes:
    return local.read(0, local.size_bytes)


def code_of(path: Path) -> str:
    with pytest.raises(StoneError) as caught:
        hashed_dataset(path, quiet)
    return caught.value.code


def test_the_tar_of_a_folder_holds_its_files_byte_for_byte(good: Path) -> None:
    local = hashed_dataset(good, quiet)
    with tarfile.open(fileobj=io.BytesIO(whole(local))) as tar:
        held = {one.name: tar.extractfile(one).read() for one in tar.getmembers()}  # type: ignore[union-attr]
    there = {path.relative_to(good).as_posix(): path.read_bytes() for path in good.rglob("*") if path.is_file()}
    assert held == there
    assert local.sha256 == sha256(whole(local)).hexdigest()
    assert (local.name, dataset_name(good)) == ("field.tar", "field")


def test_equal_folders_give_equal_tars_whenever_they_were_written(good: Path, tmp_path: Path) -> None:
    again = tmp_path / "elsewhere" / "field"
    shutil.copytree(good, again)
    os.utime(again / "v1.0-trainval" / "scene.json", (1, 1))
    assert hashed_dataset(again, quiet).sha256 == hashed_dataset(good, quiet).sha256


def test_a_dataset_one_folder_below_and_a_tar_are_sent_as_they_are(good: Path, tmp_path: Path) -> None:
    assert hashed_dataset(good.parent, quiet).sha256 == hashed_dataset(good, quiet).sha256
    path = write_published_tar(tmp_path / "theirs.tar", GOOD, "theirs/")
    assert hashed_dataset(path, quiet).sha256 == sha256(path.read_bytes()).hexdigest()
    assert dataset_name(path) == "theirs"


@settings(max_examples=50, deadline=None)
@given(start=st.integers(0, 2**22), length=st.integers(0, 2**16))
def test_any_part_is_that_part_of_the_whole(good: Path, start: int, length: int) -> None:
    local = hashed_dataset(good, quiet)
    start = min(start, local.size_bytes)
    assert local.read(start, length) == whole(local)[start : start + length]


def test_hidden_files_and_names_with_blanks_stay_here(good: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(good, tmp_path / "field"))
    (copy / ".git").mkdir()
    for name in (".git/config", ".DS_Store", "read me.txt"):
        (copy / name).write_text("ours")
    assert hashed_dataset(copy, quiet).sha256 == hashed_dataset(good, quiet).sha256


def test_links_within_are_followed_and_those_that_lead_outside_are_refused(good: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(good, tmp_path / "field"))
    (copy / "samples" / "again").symlink_to(copy / "samples")
    (copy / "sweeps").symlink_to(copy / "samples" / "LIDAR_TOP")
    (tmp_path / "sent.tar").write_bytes(whole(hashed_dataset(copy, quiet)))
    names = {name for name, _place in tar_members(tmp_path / "sent.tar")}
    assert {f"sweeps/{path.name}" for path in (good / "samples" / "LIDAR_TOP").iterdir()} < names
    (copy / "maps").symlink_to("/etc")
    assert code_of(copy) == "DST-004"


def test_a_layout_that_the_server_would_refuse_is_refused_here_by_the_same_code(good: Path, tmp_path: Path) -> None:
    """Of every kind the code of `stone check`, which is the server's own reader, is the oracle."""
    (tmp_path / "empty").mkdir()
    two = Path(shutil.copytree(good, tmp_path / "two"))
    shutil.copytree(two / "v1.0-trainval", two / "v1.0-mini")
    packed = tmp_path / "packed.tar.gz"
    packed.write_bytes(gzip.compress(write_published_tar(tmp_path / "good.tar", GOOD).read_bytes()))
    outside, linked = (write_published_tar(tmp_path / name, GOOD) for name in ("outside.tar", "linked.tar"))
    for path, name, kind in ((outside, "../x", tarfile.REGTYPE), (linked, "samples/x", tarfile.SYMTYPE)):
        with tarfile.open(path, "a") as tar:
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            tar.addfile(member)
    codes = {path: code_of(path) for path in (tmp_path / "empty", two, packed, outside, linked)}
    assert list(codes.values()) == ["DST-001", "DST-002", "DST-003", "DST-004", "bad_tar"]
    for path in (two, packed, outside):
        assert codes[path] == check_dataset(path).faults.found[0].code


@pytest.mark.parametrize("changed", ["written", "removed"])
def test_a_file_that_changes_meanwhile_ends_the_upload(good: Path, tmp_path: Path, changed: str) -> None:
    copy = Path(shutil.copytree(good, tmp_path / "field"))
    local, table = hashed_dataset(copy, quiet), copy / "v1.0-trainval" / "scene.json"
    if changed == "written":
        table.write_text("[]")
    else:
        table.unlink()
    with refused_as("file_changed", match=r"scene\.json changed"):
        whole(local)


@pytest.mark.whole
def test_a_killed_upload_of_a_folder_goes_on_where_it_was(
    platform: Platform, url: str, owner: Person, good: Path, tmp_path: Path
) -> None:
    """Catches alone a folder that is begun anew, or whose second half comes of another tar than its first."""
    copy = Path(shutil.copytree(good, tmp_path / "field"))
    for number in range(16):
        (copy / "samples" / f"more-{number}.bin").write_bytes(os.urandom(2**20))
    with Api(Server(url, owner.secret)) as api:
        command = [sys.executable, "-c", CLIENT, url, owner.secret, str(copy)]
        client = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        until(lambda: sum(int(item["offset_bytes"]) for item in api.pages("/uploads")) > 2**20)
        client.kill()
        client.communicate()
        local = hashed_dataset(copy, quiet)
        told: list[tuple[str, int, int]] = []
        upload_id = upload_file(api, local, Purpose("dataset"), lambda *said: told.append(said))
        assert 2**20 < told[0][1] < local.size_bytes, "it began where the killed one ended"
        (only,) = api.pages("/uploads")
    assert (only["state"], only["purpose"], only["sha256"]) == ("complete", "dataset", local.sha256)
    assert stored_file(platform.settings, upload_id).read_bytes() == whole(local)


WHAT = SyntheticDataset(labels=(made_labels(),), splits={"train": ["field-0000"]})


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_published(tmp_path / "dataset", WHAT)


def test_a_folder_and_a_tar_give_the_same_record(dataset: Path, tmp_path: Path) -> None:
    in_tar = stone("check", write_published_tar(tmp_path / "dataset.tar", WHAT, "top/"), "--json")
    in_folder = stone("check", dataset, "--json")
    assert in_folder.exit_code == in_tar.exit_code == 0
    assert json.loads(in_folder.stdout) == json.loads(in_tar.stdout)
    assert json.loads(in_folder.stdout)["frames"] == 6


def test_a_zip_is_sent_as_it_is_and_checked_where_it_lies_by_the_grid_that_is_stated(tmp_path: Path) -> None:
    twin = write_released_zip(tmp_path / "STONE.zip", ReleasedDataset(scenes=1, frames=2))
    assert (whole(hashed_dataset(twin, quiet)), dataset_name(twin)) == (twin.read_bytes(), "STONE")
    record = json.loads(stone("check", twin, "--json").stdout)
    assert (record["layout"], record["grid"]["name"], record["frames"]) == ("release", "release", 2)
    (tmp_path / "grid.json").write_text(json.dumps(record["grid"] | {"name": "card", "min_m": [-39.8, -40, -1]}))
    for stated, code in (("paper", "DST-063"), (tmp_path / "grid.json", "DST-073")):
        told = stone("check", twin, "--grid", stated)
        assert told.exit_code == 1
        assert code in told.stderr
    twin.write_bytes(twin.read_bytes()[:-100])
    assert code_of(twin) == "DST-006"


def test_every_fault_is_a_line_and_the_exit_code_is_one(dataset: Path) -> None:
    path = dataset / VERSION / "ego_pose.json"
    rows = json.loads(path.read_text())
    for row in rows[:3]:
        row["rotation"] = [2, 0, 0, 0]
    path.write_text(json.dumps(rows))
    found = stone("check", dataset, "--faults", "2", "--json")
    assert found.exit_code == 1
    lines = found.stderr.splitlines()
    assert [line.partition(":")[0] for line in lines if line.startswith("DST")] == ["DST-022", "DST-022"]
    assert "… and 1 more" in lines
    assert "These faults are from its rows" in lines[-1]
    record = json.loads(found.stdout)
    assert (record["faults_total"], record["reached"]) == (3, "rows")
    assert record["faults"][0]["file"] == f"{VERSION}/ego_pose.json"
    assert [fault["row"] for fault in record["faults"]] == [1, 2]
