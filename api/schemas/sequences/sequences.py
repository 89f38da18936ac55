"""Sequences over the wire."""

from datetime import datetime
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, Body, IdText, Line, coded, example
from api.schemas.sequences.previews import PREVIEW_EXAMPLE, PreviewItem
from stone.sensors.sequence import NAME, SequenceNameError
from stone.splits.surroundings import (
    ENVIRONMENTS,
    ILLUMINATIONS,
    REGION,
    checked_environment,
    checked_illumination,
    checked_region,
)

ARTEFACT_EXAMPLE = {
    "name": "mesh.ply",
    "media_type": "model/ply",
    "size_bytes": 48210333,
    "sha256": SHA256_EXAMPLE,
}
SEQUENCE_EXAMPLE: dict[str, Any] = {
    "id": ID_EXAMPLE,
    "owner_id": ID_EXAMPLE,
    "name": "forest-2026-05-03",
    "environment": "mountain",
    "illumination": "day",
    "region": "Gyeonggi",
    "platform": "warthog-1",
    "is_public": False,
    "calibration_id": ID_EXAMPLE,
    "recordings": 1,
    "job": {"id": ID_EXAMPLE, "kind": "sequence.process", "state": "succeeded"},
    "labels": {
        "id": ID_EXAMPLE,
        "job_id": ID_EXAMPLE,
        "frames": 1200,
        "code_version": "71299b6a455d",
        "created_at": "2026-05-03T10:20:00Z",
        "chosen_at": "2026-05-03T10:20:00Z",
    },
    "class_voxels": {"t": 812345, "p": 2045312, "n": 4198273},
    "duration_s": 120.1,
    "distance_m": 143.7,
    "split": "train",
    "picture": "thumbnail.png",
    "revision": 3,
    "created_at": "2026-05-03T09:12:44.120000Z",
}


def _plain_name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ValueError(str(SequenceNameError(name)))
    return name


SequenceName = Annotated[
    str, Field(min_length=1, max_length=100, pattern=f"^{NAME.pattern}$"), AfterValidator(_plain_name)
]


Environment = Annotated[
    str, AfterValidator(coded(checked_environment)), Field(json_schema_extra={"enum": ["", *ENVIRONMENTS]})
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
    """What is to change; what is left out stays. With labels the name stays too: frame tokens are made of it.

    What is made of a public sequence may be looked at by anybody, without an account.
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


class LabelGlance(Answer):
    """The label set of a sequence that counts; `code_version` names the sources that made it.

    `chosen_at` is when it came to count: made, or asked for again.
    """

    id: str
    job_id: str
    frames: int
    code_version: str
    created_at: datetime
    chosen_at: datetime


class ClassVoxels(Answer):
    """Voxels of all frames by traversability class."""

    t: int
    p: int
    n: int


class SequenceItem(Answer):
    """A sequence as a list shows it.

    What its labels add up to is null without them, or where an earlier version did not write it down. `split` is train,
    val, test or null, and told to its owner and to administrators only. `picture` names a preview, if any.
    """

    model_config = example(**SEQUENCE_EXAMPLE)

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
    class_voxels: ClassVoxels | None
    duration_s: float | None
    distance_m: float | None
    split: str | None
    picture: str | None
    revision: int
    created_at: datetime


class ArtefactItem(Answer):
    """One file of a label set."""

    model_config = example(**ARTEFACT_EXAMPLE)

    name: str
    media_type: str
    size_bytes: int
    sha256: str


class LaterRecordingsItem(Answer):
    """Recordings that the labels of a sequence were not made of, by name.

    It is processed again by itself, with the last run's request; `why_not` says why it is not, "" where it is.
    """

    model_config = example(names=["cameras.mcap"], why_not="")

    names: list[str]
    why_not: str


class SequenceDetail(SequenceItem):
    """A sequence with the files of its newest label set, and pictures of what they were made of.

    The packs of labels are reached through its frames. `later_recordings` were added after its labels were made; null
    where none were, and told to its owner and to administrators only.
    """

    model_config = example(
        **SEQUENCE_EXAMPLE, artefacts=[ARTEFACT_EXAMPLE], previews=[PREVIEW_EXAMPLE], later_recordings=None
    )

    later_recordings: LaterRecordingsItem | None
    artefacts: list[ArtefactItem]
    previews: list[PreviewItem]
