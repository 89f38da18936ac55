"""An import of a published dataset without a platform: the output of its children in a folder."""

import tarfile
from hashlib import file_digest
from pathlib import Path

from services.labeler.child_answers import PublicationAnswer
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_import import import_scene
from services.labeler.imports.scene_parts import OUT, DatasetOpening, SceneOpening, scene_folder
from stone_datasets.classes import OWN_CLASSES, ClassMap
from testing.worlds.published_datasets import SyntheticDataset, write_published_tar

NAME = "published"


def silent(_stage: str, _done: int, _total: int) -> None:
    """Ignore progress."""


def tar_of(folder: Path, tar: Path) -> Path:
    """Write the tar of a dataset in a folder, as the client uploads it."""
    with tarfile.open(tar, "w", dereference=True) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.add(path, path.relative_to(folder).as_posix())
    return tar


def write_index(dataset: Path, out: Path, classes: ClassMap = OWN_CLASSES) -> DatasetIndexAnswer:
    """Index the tar into the new folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    with dataset.open("rb") as file:
        opening = DatasetOpening(dataset, NAME, file_digest(file, "sha256").hexdigest(), classes)
    return DatasetIndexAnswer.believed(index_dataset(opening, out, silent))


def write_scene(dataset: Path, out: Path, ordinal: int, classes: ClassMap = OWN_CLASSES) -> PublicationAnswer:
    """Import a scene of the tar that was indexed into `out`; its artefacts are in `artefacts_of(out, ordinal)`."""
    opening = SceneOpening(dataset, ordinal, classes)
    return PublicationAnswer.believed(import_scene(opening, out, silent))


def write_import(dataset: Path, out: Path, classes: ClassMap = OWN_CLASSES) -> list[PublicationAnswer]:
    """Index the dataset, a tar or a folder (its tar is written beside it), and import all its scenes into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    tar = dataset if dataset.is_file() else tar_of(dataset, out / "dataset.tar")
    scenes = write_index(tar, out, classes).scenes
    return [write_scene(tar, out, scene.ordinal, classes) for scene in scenes]


def write_synthetic_import(what: SyntheticDataset, out: Path) -> list[PublicationAnswer]:
    """Import a synthetic dataset into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    return write_import(write_published_tar(out / "dataset.tar", what), out)


def artefacts_of(out: Path, ordinal: int = 0) -> Path:
    """Return the folder of a scene's artefacts."""
    return out / scene_folder(ordinal) / OUT
