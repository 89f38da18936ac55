"""Sequences over the wire."""

from dataclasses import replace
from decimal import Decimal
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StrictFloat, StrictInt

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Instant, Line, coded, example, example_of
from api.schemas.class_counts import ClassCounts
from api.schemas.grids import GridBody, GridName, chosen_grid
from api.schemas.quality import QualityFields
from services.domain.sequences.label_choices import DEFAULT_PROFILE, LabelProfile
from services.domain.sequences.processing import ProcessRequest
from stone.sensors.sequence import NAME, bad_sequence_name
from stone.splits.surroundings import (
    ENVIRONMENT,
    ILLUMINATIONS,
    OFFERED,
    REGION,
    checked_environment,
    checked_illumination,
    checked_region,
)
from stone_files.joined_file import MOST_MEMBERS, MOST_OFFSET_NS


class PreviewItem(Answer):
    """A picture or page to look at; its bytes are at `previews/{name}`."""

    model_config = example(name="cameras.jpg", media_type="image/jpeg", size_bytes=182044)

    name: str
    media_type: str
    size_bytes: int
    sha256: str


def _plain_name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError(str(bad_sequence_name(name)))
    return name


SequenceName = Annotated[
    str, Field(min_length=1, max_length=100, pattern=f"^{NAME.pattern}$"), AfterValidator(_plain_name)
]


Environment = Annotated[
    str,
    AfterValidator(coded(checked_environment)),
    Field(max_length=64, json_schema_extra={"pattern": f"^({ENVIRONMENT.pattern})?$"}, examples=[*OFFERED]),
]
Illumination = Annotated[
    str, AfterValidator(coded(checked_illumination)), Field(json_schema_extra={"enum": ["", *ILLUMINATIONS]})
]
Region = Annotated[
    str, AfterValidator(coded(checked_region)), Field(json_schema_extra={"pattern": f"^({REGION.pattern})?$"})
]


class NewSequenceBody(Body):
    """A new sequence; its name is unique among its owner's. '' is unspecified.

    Each illumination is day or night, dawn and dusk being day; a region is a plain name of one's own choice.
    """

    model_config = example(
        name="forest-2026-05-03", environment="mountain", illumination="day", region="Gyeonggi", platform="warthog-1"
    )

    name: SequenceName
    environment: Environment = ""
    illumination: Illumination = ""
    region: Region = ""
    platform: Line = ""


class SequenceChangesBody(Body):
    """Changes; missing keys stay. With labels the name stays too, because frame tokens contain it.

    The products of a public sequence are visible to everyone, without an account.
    """

    model_config = example(illumination="dusk")

    name: SequenceName | None = None
    environment: Environment | None = None
    illumination: Illumination | None = None
    region: Region | None = None
    platform: Line | None = None
    is_public: bool | None = None


class PinCalibrationBody(Body):
    """Which calibration the sequence is to be processed with."""

    model_config = example(calibration_id=ID_EXAMPLE)

    calibration_id: IdText


class JobGlance(Answer):
    """The newest run of a sequence, in two words."""

    id: str
    kind: str
    state: str


class LabelGlance(QualityFields):
    """The active label set of a sequence; `code_version` names the sources that made it.

    `chosen_at` is the time at which it became active: made, or requested again.
    """

    id: str
    job_id: str
    frames: int
    code_version: str
    created_at: Instant
    chosen_at: Instant


class SequenceItem(Answer):
    """A sequence as a list shows it.

    Totals of its labels are null without labels, or for labels of an earlier release. `split` is train, val, test or
    null, and shown to its owner and to administrators only. `picture` names a preview, if any.
    """

    model_config = example(
        name="forest-2026-05-03",
        environment="mountain",
        illumination="day",
        region="Gyeonggi",
        platform="warthog-1",
        is_public=False,
        recordings=1,
        job={"id": ID_EXAMPLE, "kind": "sequence.process", "state": "succeeded"},
        labels={
            "id": ID_EXAMPLE,
            "job_id": ID_EXAMPLE,
            "frames": 1200,
            "code_version": "71299b6a455d",
            "created_at": "2026-05-03T10:20:00Z",
            "chosen_at": "2026-05-03T10:20:00Z",
            **example_of(QualityFields),
        },
        class_voxels=example_of(ClassCounts) | {"free": None},
        duration_s=120.1,
        distance_m=143.7,
        split="train",
        picture="thumbnail.png",
        revision=3,
    )

    id: str
    owner_id: str
    name: str
    environment: str
    illumination: str
    region: str
    platform: str
    is_public: bool
    calibration_id: str | None
    recordings: int
    job: JobGlance | None
    labels: LabelGlance | None
    class_voxels: ClassCounts | None
    duration_s: float | None
    distance_m: float | None
    split: str | None
    picture: str | None
    revision: int
    created_at: Instant


class ArtefactItem(PreviewItem):
    """One file of a label set."""

    model_config = example(name="mesh.ply", media_type="model/ply", size_bytes=48210333)


class LaterRecordingsItem(Answer):
    """Recordings that the labels of a sequence do not contain, by name.

    It is processed again automatically, with the last run's request; `why_not` is the reason if it is not, else "".
    """

    model_config = example(names=["cameras.mcap"], why_not="")

    names: list[str]
    why_not: str


class SequenceDetail(SequenceItem):
    """A sequence with the files of its newest label set, and pictures of its sources.

    Its frames link to the packs of labels. `later_recordings` were added after its labels were made; null without such
    recordings, and shown to its owner and to administrators only.
    """

    model_config = example(later_recordings=None)

    later_recordings: LaterRecordingsItem | None
    artefacts: list[ArtefactItem]
    previews: list[PreviewItem]


TOPIC_PATTERN = r"^/?[A-Za-z0-9_][A-Za-z0-9_/]*$"
LONGEST_TOPIC = 256
Topic = Annotated[str, Field(max_length=LONGEST_TOPIC, pattern=TOPIC_PATTERN)]
CourseOfTopic = Annotated[str, Field(max_length=LONGEST_TOPIC, pattern=TOPIC_PATTERN.replace("^", "^course:"))]
ParameterName = Annotated[str, Field(max_length=64, pattern=r"^[a-z][a-z0-9_.]*$")]


RecordingName = Annotated[str, Field(min_length=1, max_length=255)]
# Text keeps every nanosecond; for years, a JSON number is exact only to tens of nanoseconds.
OffsetSeconds = Annotated[Decimal, Field(ge=-MOST_OFFSET_NS / 1e9, le=MOST_OFFSET_NS / 1e9, allow_inf_nan=False)]


class ProcessBody(Body):
    """A request to label a sequence; missing parameters have the defaults of the profile.

    Without `recording_ids` it uses all registered recordings, and runs again automatically when a recording is added.
    `clock_offsets_s`, by id or name of a recording, are added to its times and replace the measured ones. `grid` is the
    grid of the labels.
    """

    model_config = example(
        profile="field",
        parameters={"reference.alpha": 0.05},
        odometry_topic="/novatel/oem7/odom",
    )

    profile: LabelProfile = DEFAULT_PROFILE
    parameters: dict[ParameterName, StrictInt | StrictFloat] = Field(default={}, max_length=64)
    odometry_topic: Literal["kiss-icp"] | Topic | CourseOfTopic | None = None
    lidar_topic: Topic | None = None
    ground: Literal["given", "auto"] = "given"
    stages: list[Literal["synchronise", "label"]] = Field(default=["synchronise", "label"], min_length=1, max_length=2)
    recording_ids: list[IdText] = Field(default=[], max_length=MOST_MEMBERS)
    clock_offsets_s: dict[RecordingName, OffsetSeconds] = Field(
        default={}, max_length=MOST_MEMBERS, examples=[{"cameras.mcap": -0.08}]
    )
    grid: GridName | GridBody = "paper"

    def chosen(self) -> ProcessRequest:
        """Return the request as the runtime's value. Raises `bad_grid`."""
        stages = tuple[str, ...](self.stages)
        topics = (self.odometry_topic, self.lidar_topic)
        chosen = ProcessRequest(self.profile, self.parameters, *topics, stages, ground=self.ground)
        offsets_ns = {name: round(offset_s * 10**9) for name, offset_s in self.clock_offsets_s.items()}
        chosen = replace(chosen, recording_ids=tuple(self.recording_ids), clock_offsets_ns=offsets_ns)
        return replace(chosen, grid=chosen_grid(self.grid))


class FrameItem(Answer):
    """A labelled frame in the order of time; `stamp_ns` is its LiDAR stamp."""

    model_config = example(token=ID_EXAMPLE, ordinal=17, stamp_ns=1777800000000000000)

    token: str
    ordinal: int
    stamp_ns: int


class FrameDetail(FrameItem):
    """A labelled frame, with where it comes from and what its `labels.npz` weighs."""

    model_config = example(labels_bytes=20480, parameters={"profile": "field"})

    sequence_id: str
    label_set_id: str
    labels_bytes: int
    labels_sha256: str
    parameters: dict[str, Any]
