"""Imports of published datasets over the wire."""

from typing import Annotated, Self

from pydantic import Field, StringConstraints, model_validator

from api.schemas.base import ID_EXAMPLE, PLAIN, PROSE, Answer, Body, IdText, Instant, Line, example
from api.schemas.grids import GridBody, GridName, chosen_grid
from api.schemas.jobs import FailureItem
from api.schemas.sequences.recordings import PlaceBody, PlaceItem
from api.schemas.sequences.sequences import Environment, Illumination, Region
from services.domain.imports.requests import LONGEST_NAME, Existing, ImportedFacts, NewImport, StatedClasses
from stone_datasets.stated_layout import StatedLayout

LONGEST_CLASSES = 64 * 1024
DatasetLabel = Annotated[
    str, StringConstraints(pattern=PLAIN, min_length=1, max_length=LONGEST_NAME, strip_whitespace=True)
]
ClassesText = Annotated[str, StringConstraints(pattern=PROSE, min_length=1, max_length=LONGEST_CLASSES)]


class NewDatasetImportBody(Body):
    """An import of a dataset: a complete upload of purpose `dataset`, or a .zip or .tar `in_place`, read where it lies.

    - `name`: default is the name of its file.
    - `layout` and `grid`: those of its label files; recognised automatically by default.
    - `classes`: text of a class map in YAML or JSON: `name`, and `classes` from number to free, T, P, N or unobserved.
      By default labels are numbered as here.
    - `existing`: a scene with the name of one of your sequences is refused, or (`add`) becomes another label set of it.
    - `sets_splits`: administrators only.

    All other values apply to every new sequence.
    """

    model_config = example(
        upload_id=ID_EXAMPLE,
        name="offroad-v1.0",
        classes="name: theirs\nclasses: {0: free, 1: T, 2: P, 3: N, 255: unobserved}\n",
        existing="refuse",
        sets_splits=False,
        environment="mountain",
        illumination="day",
        region="Gyeonggi",
        platform="warthog-1",
        is_public=False,
    )

    upload_id: IdText | None = None
    in_place: PlaceBody | None = None
    name: DatasetLabel | None = None
    layout: GridName | None = None
    grid: GridName | GridBody | None = None
    classes: ClassesText | None = None
    existing: Existing = "refuse"
    sets_splits: bool = False
    environment: Environment = ""
    illumination: Illumination = ""
    region: Region = ""
    platform: Line = ""
    is_public: bool = False

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.upload_id is None) == (self.in_place is None):
            raise ValueError("give either upload_id or in_place")
        return self

    def wished(self, classes: StatedClasses | None) -> NewImport:
        """Return the import as the domain's value. Raises `bad_grid`."""
        facts = ImportedFacts(self.environment, self.illumination, self.region, self.platform, self.is_public)
        stated = StatedLayout(self.layout, None if self.grid is None else chosen_grid(self.grid))
        source = None if self.in_place is None else self.in_place.place()
        return NewImport(
            self.upload_id or "", self.name or "", classes, self.existing, self.sets_splits, facts, source, stated
        )


class DatasetImportItem(Answer):
    """An import as a list shows it; `state` is that of its run, `job_id`, and `classes` the name of its class map.

    Scenes and frames are null before the dataset's tables were read. `place` is where the archive lies that was not
    uploaded; its `sha256` is of place, size and time of change. `layout` and `grid` are the names that were stated.
    """

    model_config = example(
        name="offroad-v1.0",
        size_bytes=812345678901,
        existing="refuse",
        sets_splits=False,
        state="succeeded",
        failure=None,
        scenes_total=43,
        scenes_done=43,
        frames=50878,
        finished_at="2026-05-03T11:40:02Z",
    )

    id: str
    owner_id: str
    job_id: str
    name: str
    sha256: str
    size_bytes: int
    place: PlaceItem | None = None
    classes: str | None
    layout: str | None = None
    grid: str | None = None
    existing: Existing
    sets_splits: bool
    state: str
    failure: FailureItem | None = Field(description="The first fault; its sentence begins with file, row and token.")
    scenes_total: int | None
    scenes_done: int
    frames: int | None
    created_at: Instant
    finished_at: Instant | None


class ImportedSceneItem(Answer):
    """A scene: `state` is that of the job that imports it, `sequence_id` its sequence once all of them stand."""

    model_config = example(ordinal=0, name="field-0000", frames=1183, splits=["train"], state="succeeded")

    ordinal: int
    name: str
    frames: int
    splits: list[str]
    state: str
    sequence_id: str | None


class ExtraFileItem(Answer):
    """A file of the dataset that no table names, by its name below the dataset's root."""

    model_config = example(name="nuscenes_infos_val.pkl", size_bytes=40123456)

    name: str
    size_bytes: int


class DatasetImportDetail(DatasetImportItem):
    """An import with its scenes, in the order of the dataset's table.

    `kept_files` are unchanged files of the dataset that no table names; `left_out` are the first of the
    `left_out_total` files that are too large or too many.

    `splits_refused` are the codes of the rules that the dataset's splits break, so that the draft splits stayed. It is
    `no_splits` if the dataset states none, and null if they were not requested, or are not set yet.
    """

    model_config = example(left_out_total=0)

    splits_refused: list[str] | None
    kept_files: list[ExtraFileItem]
    left_out: list[ExtraFileItem]
    left_out_total: int
    scenes: list[ImportedSceneItem]
