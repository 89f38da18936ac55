"""Descriptions of real recordings: a small file `*.real.yaml` with known facts, validated.

**Conventions.** A path is relative to the description, or else to the folder of recordings. Plan coordinates are metres
in the recording's map, the frame of its poses; for a scan, in its ego frame.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from benchmarks.real.errors import DescriptionError
from stone.sensors.sequence import NAME
from stone_recordings.calibrations.plain_yaml import parse_documents

SUFFIX = ".real.yaml"
OURS = Path(__file__).with_name("descriptions")
MOST_BYTES = 1_000_000

Coordinate = Annotated[float, Field(ge=-100_000, le=100_000, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate]
Polygon = Annotated[tuple[Point, ...], Field(min_length=3, max_length=1000)]
Line = Annotated[tuple[Point, ...], Field(min_length=2, max_length=1000)]
ClassId = Annotated[int, Field(ge=0, le=65_535)]
Classes = Annotated[dict[str, ClassId], Field(min_length=1)]
Passes = Literal["parity", "halves"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LabelledScan(_Part):
    """One scan with a class per point.

    It has float32 x, y, z, intensity in the LiDAR's frame, and uint32 whose lower 16 bits are the class
    (SemanticKITTI's files). `stamp_ns` is that of its frame; a single scan has only one.
    """

    points: str
    labels: str
    stamp_ns: int | None = None


class Semantics(_Part):
    """Labelled scans, with the classes (name → number) that are drivable, and the classes that are obstacles."""

    scans: Annotated[tuple[LabelledScan, ...], Field(min_length=1)]
    ground: Classes
    obstacle: Classes


class Description(_Part):
    """The known facts of one recording, or of one scan without poses (`scan`: float32 x, y, z, intensity).

    A recording has the track of its poses. For a scan, `tracks_m` (name → corners from the robot's own position, in its
    ego frame) are paths that a person declared drivable. Each is tried as the track, besides the footprint alone.
    `ring_spacing_deg` is the approximate spacing of the LiDAR's channels.
    """

    stone_real: Literal[1]
    name: Annotated[str, Field(pattern=f"^(?:{NAME.pattern})$")]
    about: str
    calibration: str
    recording: str | None = None
    scan: str | None = None
    tracks_m: dict[str, Line] = {}
    ring_spacing_deg: Annotated[float, Field(ge=0.05, le=10, allow_inf_nan=False)] = 0.4
    passes: tuple[Passes, ...] = ("parity", "halves")
    semantics: Semantics | None = None
    flat_m: tuple[Polygon, ...] = ()
    flat_beside_track_m: Annotated[float, Field(ge=0, le=25, allow_inf_nan=False)] = 0.0
    walls_m: tuple[Line, ...] = ()

    @model_validator(mode="after")
    def _is_one_thing(self) -> Self:
        if (self.recording is None) == (self.scan is None):
            raise ValueError("give either `recording`, a bag, or `scan`, a file of points")
        if self.recording is not None and self.tracks_m:
            raise ValueError("`tracks_m` applies to scans only; the track of a recording follows from its poses")
        if self.semantics is not None and self.recording is not None:
            stampless = [scan.points for scan in self.semantics.scans if scan.stamp_ns is None]
            if stampless:
                raise ValueError(f"{stampless[0]} requires `stamp_ns`, the stamp of its frame in the recording")
        return self


@dataclass(frozen=True)
class Described:
    """A description and the folders of its paths."""

    description: Description
    path: Path
    folder: Path

    @property
    def source(self) -> Path:
        """The path of the recording or the scan; it need not exist."""
        return self.file(self.description.recording or self.description.scan or "")

    def file(self, name: str) -> Path:
        """Return the path of a file of the description; it need not exist."""
        beside = self.path.parent / name
        return beside if beside.exists() else self.folder / name


def described_in(folder: Path) -> list[Described]:
    """Return every recording of the folder with a description in it, or with one of the project's own.

    Raises `DescriptionError`, `CalibrationYamlError`; a description in the folder whose recording is missing is wrong.
    """
    paths = [path for path in sorted(folder.rglob(f"*{SUFFIX}")) if path.parent.resolve() != OURS.resolve()]
    theirs = [read_description(path, folder) for path in paths]
    for description in theirs:
        if not description.source.exists():
            raise DescriptionError(description.path, f"{description.source} does not exist")
    ours = [read_description(path, folder) for path in own_descriptions()]
    return _of_one_name_each([*(description for description in ours if description.source.exists()), *theirs])


def own_descriptions() -> list[Path]:
    """Return the paths of the project's own descriptions."""
    return sorted(OURS.glob(f"*{SUFFIX}"))


def read_description(path: Path, folder: Path) -> Described:
    """Return the description in this file. Raises `DescriptionError`, `CalibrationYamlError`."""
    if path.stat().st_size > MOST_BYTES:
        raise DescriptionError(path, f"has {path.stat().st_size} bytes; a description has at most {MOST_BYTES}")
    documents = parse_documents(path.name, path.read_bytes())
    if len(documents) != 1:
        raise DescriptionError(path, f"contains {len(documents)} documents, but must be one")
    try:
        return Described(Description.model_validate(documents[0]), path, folder)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise DescriptionError(path, f"{where}: {first['msg']}") from None


def _of_one_name_each(described: list[Described]) -> list[Described]:
    """Return the descriptions. Raises `DescriptionError` if two have the same name, as their labels would collide."""
    paths: dict[str, Path] = {}
    for item in described:
        name = item.description.name
        if name in paths:
            raise DescriptionError(item.path, f"has the name {name!r} of {paths[name]}; give it another name")
        paths[name] = item.path
    return described
