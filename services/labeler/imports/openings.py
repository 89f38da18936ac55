"""What the sandboxed children of an import are given: the tar of a dataset, and what is to be made of it.

**Conventions.** Values that can be pickled. A child works in the folder `dataset` of the run's workspace: the one that
indexes leaves the tables of a scene, and where its files lie in the tar, in `scenes/<ordinal in six digits>/`; the one
that imports that scene reads them there and leaves its artefacts, by their names, in the folder `out` beside.
"""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from stone_datasets.classes import ClassMap

SCENES, OUT = "scenes", "out"


@dataclass(frozen=True)
class DatasetOpening:
    """A whole dataset: its tar, what its owner calls it, the tar's sha256, and what the numbers of its labels mean."""

    dataset: Path
    name: str
    sha256: str
    classes: ClassMap


@dataclass(frozen=True)
class SceneOpening:
    """One scene of a dataset that was indexed: as `DatasetOpening`, and the scene's place in the dataset."""

    dataset: Path
    ordinal: int
    name: str
    sha256: str
    classes: ClassMap


def scene_folder(ordinal: int) -> PurePosixPath:
    """Where the files of a scene lie below the child's folder."""
    return PurePosixPath(SCENES, f"{ordinal:06d}")
