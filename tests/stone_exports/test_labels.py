"""Labels of exports: what was observed has its class; what is no labels.npz is refused, however large it says it is."""

import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from stone_exports.files import DamagedExportError, ExportFileSpan, FolderFiles
from stone_exports.frames import frames_in
from stone_exports.labels import observed_classes
from stone_files.npz import npz_bytes

SHAPE = (256, 256, 32)
Grid = NDArray[np.uint8]


def span_of(path: Path, content: bytes) -> ExportFileSpan:
    path.write_bytes(content)
    return ExportFileSpan(path, path.name, 0, len(content))


def grids(**arrays: Grid) -> dict[str, Grid]:
    return {"semantics": np.zeros(SHAPE, np.uint8), "mask_lidar": np.ones(SHAPE, np.uint8)} | arrays


def header(text: str) -> bytes:
    return b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text.encode()


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def test_what_nobody_observed_is_ignored_and_a_surface_is_observed(tmp_path: Path) -> None:
    semantics, mask = np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, np.uint8)
    semantics[1, 2, 3], semantics[4, 5, 6], mask[4, 5, 6], mask[7, 8, 9] = 3, 1, 1, 255
    found = observed_classes(span_of(tmp_path / "labels.npz", npz_bytes(grids(semantics=semantics, mask_lidar=mask))))
    assert (found[1, 2, 3], found[4, 5, 6], found[7, 8, 9], found[0, 0, 0]) == (3, 1, 0, 255)
    assert (found == 255).sum() == found.size - 3


def test_ours_and_numpys_files_read_alike(rig: Path, tmp_path: Path) -> None:
    span = frames_in(FolderFiles(rig))[0].labels
    assert span is not None
    with np.load(span.path) as arrays:
        semantics, mask = arrays["semantics"], arrays["mask_lidar"]
        for save in (np.savez, np.savez_compressed):
            save(tmp_path / "again.npz", **arrays)
            again = ExportFileSpan(tmp_path / "again.npz", "a", 0, (tmp_path / "again.npz").stat().st_size)
            assert np.array_equal(observed_classes(again), observed_classes(span))
    assert np.array_equal(observed_classes(span), np.where((mask == 0) & (semantics == 0), 255, semantics))


NPY = npz_bytes(grids())
PETABYTE = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({10**15},), }}\n"
LIES: dict[str, tuple[Callable[[], bytes], str]] = {
    "class 7": (lambda: npz_bytes(grids(semantics=np.full(SHAPE, 7, np.uint8))), "it has class 7, the highest is 3"),
    "another shape": (lambda: npz_bytes(grids(semantics=np.zeros((256, 256, 31), np.uint8))), r"uint8 \(256, 256, 31"),
    "a mask of another shape": (lambda: npz_bytes(grids(mask_lidar=np.zeros(3, np.uint8))), r"mask_lidar is uint8"),
    "another type": (lambda: npz_bytes(grids(semantics=np.zeros(SHAPE, np.int8))), "semantics is int8"),
    "no mask": (lambda: npz_bytes({"semantics": np.zeros(SHAPE, np.uint8)}), "not an npz of semantics, mask_lidar"),
    "no zip": (lambda: b"labels", "not an npz of"),
    "nothing": (lambda: b"", "not an npz of"),
    "cut": (lambda: NPY[: len(NPY) // 2], "not an npz of"),
    "flipped bytes": (lambda: NPY[:60] + bytes(b ^ 255 for b in NPY[60:90]) + NPY[90:], "not an npz of"),
    "no array": (lambda: zipped({"semantics.npy": b"x", "mask_lidar.npy": b"x"}), "not an npz of"),
    "an array that ends early": (
        lambda: zipped({"semantics.npy": header(f"{{'descr': '|u1', 'fortran_order': False, 'shape': {SHAPE}, }}\n")}),
        "not an npz of",
    ),
    "an array in another order": (
        lambda: zipped({"semantics.npy": header(f"{{'descr': '|u1', 'fortran_order': True, 'shape': {SHAPE}, }}\n")}),
        "expected is uint8",
    ),
    "an array of a petabyte": (
        lambda: zipped({"semantics.npy": header(PETABYTE)}),
        "expected is uint8",
    ),
    "objects": (
        lambda: zipped({"semantics.npy": header("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n")}),
        "expected is uint8",
    ),
    "packed otherwise": (lambda: zipped({"semantics.npy": b"x"}, zipfile.ZIP_LZMA), "a method that npz does not use"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_what_is_no_labels_is_refused(lie: str, tmp_path: Path) -> None:
    content, why = LIES[lie]
    with pytest.raises(DamagedExportError, match=why):
        observed_classes(span_of(tmp_path / "labels.npz", content()))


def bomb(says_bytes: int) -> bytes:
    """A member of 256 MiB of zeros, whose directory says it has `says_bytes`."""
    file = bytearray(zipped({"semantics.npy": bytes(1 << 28), "mask_lidar.npy": b""}))
    for mark, at in ((b"PK\3\4", 22), (b"PK\1\2", 24)):
        place = file.index(mark) + at
        file[place : place + 4] = says_bytes.to_bytes(4, "little")
    return bytes(file)


@pytest.mark.parametrize("says_bytes", [1 << 28, 2_097_280, 100])
def test_a_zip_bomb_costs_no_memory_whatever_it_says_of_its_size(says_bytes: int, tmp_path: Path) -> None:
    span = span_of(tmp_path / "labels.npz", bomb(says_bytes))
    tracemalloc.start()
    try:
        with pytest.raises(DamagedExportError):
            observed_classes(span)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    content = bytearray(NPY)
    content[6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    with pytest.raises(DamagedExportError, match="not an npz of"):
        observed_classes(span_of(tmp_path / "labels.npz", bytes(content)))


def test_a_file_of_a_gigabyte_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with pytest.raises(DamagedExportError, match="bytes, at most"):
        observed_classes(ExportFileSpan(tmp_path / "labels.npz", "labels.npz", 0, 1 << 30))
