"""Many files in few packs: any range of any archive of them is read back from wherever the packs lie."""

import io
import random
import tarfile
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.runtime.settings import StoreSettings
from services.runtime.store.folder import FolderStore
from services.runtime.store.pack_reading import (
    ReadPack,
    StoredFiles,
    archive_pieces,
    archive_sha256,
    file_pieces,
    local_reader,
)
from services.runtime.store.packs import (
    COLUMNS,
    PackedFiles,
    index_bytes,
    pack_count,
    pack_folder,
    pack_path,
    pieces_of,
    read_index,
)
from services.runtime.store.protocol import Store
from services.runtime.store.s3 import S3Store
from stone_files.archives import KINDS, Kind, check_names, layout
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings

FILES = {
    "a/one.bin": bytes(range(256)) * 3,
    "a/two.bin": b"",
    "b.bin": b"b" * 5000,
    "c/d/e.bin": b"e" * 999,
    "f": b"f",
}


def written(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def silent(_done: int, _total: int) -> None:
    pass


def packed(base: Path, files: dict[str, bytes], pack_bytes: int = 1024) -> PackedFiles:
    return pack_folder(written(base / "files", files), base / "packs", silent, pack_bytes)


def whole(files: PackedFiles, kind: Kind, read: ReadPack) -> bytes:
    archive = layout(files.members, kind)
    return b"".join(archive_pieces(files, archive, (0, archive.size_bytes), read))


def sums_of(files: dict[str, bytes]) -> bytes:
    return "".join(f"{sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files)).encode()


names = st.sampled_from(["a", "b/c", "b/d.npz", "e_f/g/h.jpg", "z+1", "m=2@x"])


@given(
    content=st.dictionaries(names, st.binary(max_size=3000), max_size=6),
    pack_bytes=st.sampled_from([1, 700, 10**6]),
    kind=st.sampled_from(KINDS),
    data=st.data(),
)
@settings(max_examples=25, deadline=None)
def test_any_range_of_an_archive_is_read_from_the_packs(
    content: dict[str, bytes], pack_bytes: int, kind: Kind, data: st.DataObject
) -> None:
    with TemporaryDirectory() as folder:
        files = packed(Path(folder), content, pack_bytes)
        read = local_reader(Path(folder) / "packs")
        archive = whole(files, kind, read)
        assert not [path for path in (Path(folder) / "files").rglob("*") if path.is_file()]
        expected = {**content, "sha256sum.txt": sums_of(content)}
        for ordinal, name in enumerate(files.names):
            size = int(files.sizes_bytes[ordinal])
            assert b"".join(file_pieces(files, ordinal, (0, size), read)) == expected[name]
            assert files.digest(ordinal) == sha256(expected[name]).hexdigest()
        start = data.draw(st.integers(0, len(archive)))
        stop = data.draw(st.integers(start, len(archive)))
        laid = layout(files.members, kind)
        assert b"".join(archive_pieces(files, laid, (start, stop), read)) == archive[start:stop]
        assert archive_sha256(files, kind, read, silent) == (len(archive), sha256(archive).hexdigest())


def test_equal_folders_give_equal_packs_and_indexes(tmp_path: Path) -> None:
    first, second = packed(tmp_path / "1", FILES), packed(tmp_path / "2", dict(reversed(FILES.items())))
    assert index_bytes(first) == index_bytes(second)
    assert pack_count(first) == pack_count(second) > 1
    for number in range(pack_count(first)):
        one, other = (pack_path(tmp_path / base / "packs", number).read_bytes() for base in ("1", "2"))
        assert one == other


def test_an_index_says_what_was_packed(tmp_path: Path) -> None:
    files = packed(tmp_path, FILES)
    again = read_index(index_bytes(files))
    assert again.names == files.names == (*sorted(FILES), "sha256sum.txt")
    assert all((getattr(again, name) == getattr(files, name)).all() for name in COLUMNS)
    assert again.ordinals["b.bin"] == files.names.index("b.bin")


@pytest.mark.parametrize("name", ["sha256sum.txt", "Sha256Sum.TXT", "a b", ".hidden/file"])
def test_a_file_with_a_bad_name_is_refused_before_anything_is_moved(tmp_path: Path, name: str) -> None:
    with refused_as("bad_member"):
        packed(tmp_path, {**FILES, name: b"x"})
    assert {path.name for path in (tmp_path / "files").rglob("*") if path.is_file()} >= {"one.bin", "b.bin", "f"}


@pytest.fixture(params=["folder", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    if request.param == "folder":
        yield FolderStore(tmp_path / "store")
        return
    settings: StoreSettings = request.getfixturevalue("s3_settings")
    yield S3Store(make_settings(tmp_path, store=settings))


def stored(store: Store, base: Path, files: PackedFiles) -> StoredFiles:
    keys = tuple(f"blobs/{base.name}-{number}" for number in range(pack_count(files)))
    for number, key in enumerate(keys):
        store.write(key, pack_path(base / "packs", number))
    return StoredFiles(files, keys)


def test_an_archive_is_read_out_of_the_store_from_anywhere_in_it(store: Store, tmp_path: Path) -> None:
    noise = {"noise.bin": random.Random(1).randbytes(600_000), **FILES}
    kept = stored(store, tmp_path / "kept", packed(tmp_path / "kept", noise, 10**6))
    archive = whole(kept.files, "tar", kept.reader(store))
    with tarfile.open(fileobj=io.BytesIO(archive)) as opened:
        found = {member.name: opened.extractfile(member).read() for member in opened}  # type: ignore[union-attr]
    assert set(found) == set(kept.files.names)
    assert found["noise.bin"] == noise["noise.bin"]
    assert found["sha256sum.txt"] == sums_of(noise)
    laid = layout(kept.files.members, "tar")
    for start, stop in ((0, 1), (9_000, 9_600), (len(archive) // 2, len(archive) // 2 + 70_000)):
        assert b"".join(archive_pieces(kept.files, laid, (start, stop), kept.reader(store))) == archive[start:stop]
    check_names(kept.files.names)


def test_an_archive_is_read_by_few_streams_not_by_one_for_each_file(tmp_path: Path) -> None:
    many = {f"{number:04d}.bin": bytes([number % 256]) * 100 for number in range(500)}
    files = packed(tmp_path, many, 10**6)
    opened = list[tuple[int, int]]()

    def counted(number: int, start: int, stop: int) -> Iterator[bytes]:
        opened.append((number, start))
        return pieces_of(pack_path(tmp_path / "packs", number), start, stop)

    whole(files, "zip", counted)
    assert opened == [(0, 0)]


def test_a_pack_that_ends_early_is_noticed(tmp_path: Path) -> None:
    files = packed(tmp_path, FILES)
    path = pack_path(tmp_path / "packs", 0)
    path.write_bytes(path.read_bytes()[:-1])
    with refused_as("short_pack"):
        whole(files, "tar", local_reader(tmp_path / "packs"))
