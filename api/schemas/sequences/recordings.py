"""Recordings over the wire."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Instant, example, example_of
from api.schemas.jobs import JobItem
from api.schemas.sequences.calibrations import FindingItem
from api.schemas.sequences.sequences import PreviewItem
from services.domain.sequences.recordings import NewRecording
from services.runtime.uploads.creation import LONGEST_NAME_BYTES, check_filename
from services.runtime.uploads.errors import BadMetadataError
from stone_files.bag_fingerprint import MOST_FILES
from stone_recordings.sync.stored_recording import RecordingPlace


def _plain_name(name: str) -> str:
    try:
        check_filename(name)
    except BadMetadataError as error:
        raise ValueError(str(error)) from None
    return name


FolderName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME_BYTES), AfterValidator(_plain_name)]


class PlaceBody(Body):
    """A file that stays where it lies: `path` below `root`, one of the names that `GET /recording-roots` lists."""

    model_config = example(root="nas", path="released/STONE.zip")

    root: str = Field(min_length=1, max_length=32)
    path: str = Field(min_length=1, max_length=1024)

    def place(self) -> RecordingPlace:
        """Return the place as the domain's value."""
        return RecordingPlace(self.root, self.path)


class InPlaceBody(PlaceBody):
    """A bag that stays where it lies: `path` below `root`, one of the names that `GET /recording-roots` lists.

    For an object in a bucket, pictures are read only `with_pictures`: labels need none, exports of pictures do.
    """

    model_config = example(root="nas", path="2026/run_0.db3")

    with_pictures: bool = False

    def place(self) -> RecordingPlace:
        """Return the place as the domain's value."""
        return RecordingPlace(self.root, self.path, with_pictures=self.with_pictures)


class NewRecordingBody(Body):
    """Complete uploads that are to become a recording; an upload becomes one recording and no more.

    One file by `upload_id`; or the files of one rosbag2 folder by `upload_ids`, and the folder's `name`. A bag that is
    not uploaded by `in_place`.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"upload_id": ID_EXAMPLE},
                {"upload_ids": [ID_EXAMPLE, ID_EXAMPLE[::-1]], "name": "run_2026_05_03"},
                {"in_place": {"root": "nas", "path": "2026/run_0.db3"}},
            ]
        }
    )

    upload_id: IdText | None = None
    upload_ids: list[IdText] | None = Field(default=None, min_length=2, max_length=MOST_FILES)
    name: FolderName | None = None
    in_place: InPlaceBody | None = None

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if sum(given is not None for given in (self.upload_id, self.upload_ids, self.in_place)) != 1:
            raise ValueError("give exactly one of upload_id (one file), upload_ids (files of one bag) and in_place")
        if (self.upload_ids is None) != (self.name is None):
            raise ValueError("give name for a bag of several files (upload_ids), and only for such a bag")
        return self

    def received(self) -> NewRecording:
        """Return the uploads as the runtime's value."""
        if self.upload_ids is None:
            return NewRecording((self.upload_id or "",))
        return NewRecording(tuple(self.upload_ids), self.name or "")


class RecordingFileItem(Answer):
    """One file of a recording. `is_recovered`: it was cut off, and its readable part is processed."""

    model_config = example(filename="run.mcap", size_bytes=8123456789, is_recovered=False)

    upload_id: str | None
    filename: str
    size_bytes: int
    sha256: str
    is_recovered: bool


class PlaceItem(Answer):
    """The place of a recording or a dataset that was not uploaded: `path` below `root`."""

    model_config = example(root="nas", path="2026/run_0.db3")

    root: str
    path: str

    @classmethod
    def recorded(cls, record: Mapping[str, Any] | None) -> Self | None:
        """Return the place that a row records."""
        return None if record is None else cls(root=record["root"], path=record["path"])


class RecordingItem(Answer):
    """One bag of a sequence. `state`: received, registered (read and kept), refused (see `findings`).

    For several files, `sha256` is that of the lines `sha256sum` prints for them in order of name. With a `place` it is
    read where it lies, and `sha256` covers sizes, modification times and the bytes read.
    """

    model_config = example(filename="run.mcap", size_bytes=8123456789, state="registered", findings=[])

    id: str
    sequence_id: str
    filename: str
    size_bytes: int
    sha256: str
    files: list[RecordingFileItem]
    place: PlaceItem | None = None
    state: str
    findings: list[FindingItem]
    created_at: Instant


class RecordingDetail(RecordingItem):
    """A recording with its inspection: topics, roles, clocks, and quality (null until registered)."""

    model_config = example(inspection={"topics": []}, quality={"score": 87})

    inspection: dict[str, Any] | None
    quality: dict[str, Any] | None
    previews: list[PreviewItem]


class RecordingRoots(Answer):
    """Names of the roots below which bags may be read in place; their contents are not shown."""

    model_config = example(roots=["nas"])

    roots: list[str]


class RecordingAccepted(Answer):
    """The recording as it stands, and the job that reads it."""

    model_config = example(job=example_of(JobItem) | {"kind": "ingest.register"})

    recording: RecordingItem
    job: JobItem
