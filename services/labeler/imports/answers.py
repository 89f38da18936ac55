"""Permitted answers of the child that indexes a dataset; a child that imports a scene returns a `PublicationAnswer`.

**Conventions.** The pack `packs/000000.pack` in such an answer is the file `labels/000000.pack` in the scene's `out`.
"""

from typing import Annotated, ClassVar, Self

from pydantic import Field, StringConstraints, model_validator

from services.labeler.child_answers import Count
from services.runtime.sandbox.answers import SandboxAnswer
from stone.splits.surroundings import REGION
from stone_base.names import NAME
from stone_datasets.extra_files import LONGEST_NAME, MOST_FILES, MOST_SHOWN
from stone_files.archives import NAME as MEMBER

MOST_SCENES, MOST_SPLITS = 20_000, 1000
SceneName = Annotated[str, StringConstraints(pattern=f"^{NAME.pattern}$")]
Region = Annotated[str, StringConstraints(pattern=f"^({REGION.pattern})?$")]
ExtraName = Annotated[str, StringConstraints(pattern=f"^{MEMBER.pattern}$", max_length=LONGEST_NAME)]
SplitName = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class IndexedSceneAnswer(SandboxAnswer):
    """A scene: its ordinal, name, frames, labels per frame, and splits.

    `region` is the recorded region, "" if unspecified.
    """

    expected: ClassVar[str] = "a scene"
    ordinal: Count
    name: SceneName
    frames: Count
    is_labelled: bool
    splits: Annotated[tuple[SplitName, ...], Field(max_length=MOST_SPLITS)] = ()
    region: Region = ""


class ExtraFileAnswer(SandboxAnswer):
    """A file outside the tables, by its name relative to the dataset's root."""

    expected: ClassVar[str] = "a file outside the tables"
    name: ExtraName
    size_bytes: Count


class DatasetIndexAnswer(SandboxAnswer):
    """The scenes of a dataset in order, the files outside the tables, and the oversized ones."""

    expected: ClassVar[str] = "the scenes of a dataset"
    scenes: Annotated[list[IndexedSceneAnswer], Field(min_length=1, max_length=MOST_SCENES)]
    extra: Annotated[list[ExtraFileAnswer], Field(max_length=MOST_FILES)] = Field(default_factory=list)
    left_out: Annotated[list[ExtraFileAnswer], Field(max_length=MOST_SHOWN)] = Field(default_factory=list)
    left_out_total: Count = 0

    @model_validator(mode="after")
    def _are_told_apart(self) -> Self:
        if [scene.ordinal for scene in self.scenes] != list(range(len(self.scenes))):
            raise ValueError("scenes are not numbered in order")
        if len({scene.name for scene in self.scenes}) < len(self.scenes):
            raise ValueError("two scenes have the same name")
        if len({file.name for file in self.extra}) < len(self.extra):
            raise ValueError("two files have the same name")
        return self
