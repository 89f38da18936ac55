"""The reader of published datasets as a function of bytes: tables, splits, annotations, class map and labels, or a tar.

**Conventions.** The first byte selects the kind of the rest: a dataset of tables, one of annotations.json alone, or a
tar (with repaired checksums of its heads). Two zeros separate the parts of a dataset, labels last; an empty part stands
for the sound part, so one mutated part is read with sound others. Without a part for them there are no labels and no
class map: parsing grids and YAML would take most of the time.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from io import BytesIO
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_STORED, ZipFile

import numpy as np

from fuzz.exports import mended
from stone_base.label_grid import PAPER
from stone_datasets.classes import OWN_CLASSES, ClassMap, read_class_map
from stone_datasets.reading import check_dataset
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import (
    VERSION,
    SyntheticDataset,
    write_annotated,
    write_published,
    write_published_tar,
)

CLASS_FILE = "classes.yaml"
TABLES, ANNOTATED, TAR = range(3)
CLASSES = b"name: own\nclasses: {0: free, 1: T, 2: P, 3: N, 255: unobserved}\n"
OF_TABLES = ("sensor", "calibrated_sensor", "log", "scene", "sample", "ego_pose", "sample_data")
WHAT = SyntheticDataset(1, 2, cameras=("CAM_FRONT",), splits={"train": ["field-0000"]})
LABELS = tuple(f"gts/field-0000/{token}/labels.npz" for token in WHAT.tokens(0))
PARTS: Mapping[int, tuple[str, ...]] = {
    TABLES: (*(f"{VERSION}/{name}.json" for name in OF_TABLES), "splits.json", CLASS_FILE, LABELS[0]),
    ANNOTATED: ("annotations.json", CLASS_FILE, LABELS[0]),
}


def read_published(content: bytes) -> None:
    """Read everything in it, which must be sound or have named faults."""
    kind = content[0] % 3 if content else TABLES
    with TemporaryDirectory() as folder:
        path = Path(folder) / "dataset"
        if kind == TAR:
            path.write_bytes(mended(content[1:]))
            check_dataset(path)
            return
        parts = dict(zip_longest(PARTS[kind], content[1:].split(b"\0\0", len(PARTS[kind]) - 1), fillvalue=b""))
        for name, good in _good(kind).items():
            if name != CLASS_FILE and (name not in LABELS or parts[LABELS[0]]):
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                (path / name).write_bytes(parts.get(name) or good)
        check = check_dataset(path, _class_map(Path(folder) / CLASS_FILE, parts[CLASS_FILE]))
    if (check.contents is None) == (not check.faults.found):
        raise AssertionError("neither sound nor faulty")


def published_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield all parts together, and each alone."""
    for kind, names in PARTS.items():
        parts = [_good(kind)[name] for name in names]
        yield f"{kind}-all", bytes([kind]) + b"\0\0".join(parts)
        for index, part in enumerate(parts):
            yield f"{kind}-{index}", bytes([kind]) + b"\0\0" * index + part
    small = BytesIO()
    np.save(small, np.zeros(3, np.uint8))
    stored = BytesIO()
    with ZipFile(stored, "w", ZIP_STORED) as archive:
        for name in ("semantics.npy", "mask_lidar.npy"):
            archive.writestr(name, small.getvalue())
    yield "small-labels", bytes([ANNOTATED]) + b"\0\0" * 2 + stored.getvalue()
    with TemporaryDirectory() as folder:
        yield "tar", bytes([TAR]) + write_published_tar(Path(folder) / "t.tar", WHAT).read_bytes()


@cache
def _good(kind: int) -> Mapping[str, bytes]:
    """Return the files of a sound dataset of this kind by name."""
    write = write_published if kind == TABLES else write_annotated
    with TemporaryDirectory() as folder:
        path = write(Path(folder) / "good", WHAT)
        files = {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}
    free = np.zeros(PAPER.shape, np.uint8)
    labels = npz_bytes({"semantics": free, "mask_lidar": free})
    return files | dict.fromkeys(LABELS, labels) | {CLASS_FILE: CLASSES}


def _class_map(path: Path, content: bytes) -> ClassMap:
    if not content:
        return OWN_CLASSES
    path.write_bytes(content)
    return read_class_map(path)
