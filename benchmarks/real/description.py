"""Descriptions of real recordings: a small file `*.real.yaml` that says what is known of one, validated.

**Conventions.** A path is looked for beside the description, then in the folder of recordings. Plan coordinates are
metres in the recording's map, the frame of its poses; those of a scan are its ego frame.
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
    """One scan with a class per point: float32 x, y, z, intensity in the LiDAR's frame, and uint32 of which the lower
    16 bits are the class (SemanticKITTI's files). `stamp_ns` is that of its frame; a single scan has only one."""

    points: str
    labels: str
    stamp_ns: int | None = None


class Semantics(_Part):
    """Labelled scans, and which of their classes (name → number) a robot can drive on, and which stand in its way."""

    scans: Annotated[tuple[LabelledScan, ...], Field(min_length=1)]
    ground: Classes
    obstacle: Classes


class Description(_Part):
    """What is known of one recording, or of one scan without poses (`scan`: float32 x, y, z, intensity).

    A recording has the track of its poses. Of a scan, `tracks_m` (name → corners from the robot's own place on, in its
    ego frame) are ways that a person says can be driven; each is tried as the track, besides the footprint alone.
    `ring_spacing_deg` is how far the LiDAR's channels are apart, about.
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
            raise ValueError("`tracks_m` is for a scan; a recording has its poses")
        if self.semantics is not None and self.recording is not None:
            stampless = [scan.points for scan in self.semantics.scans if scan.stamp_ns is None]
            if stampless:
                raise ValueError(f"{stampless[0]} needs `stamp_ns`: which frame of the recording is it?")
        return self


@dataclass(frozen=True)
class Described:
    """A description and where its paths are looked for."""

    description: Description
    path: Path
    folder: Path

    @property
    def source(self) -> Path:
        """The recording or the scan; it need not exist."""
        return self.file(self.description.recording or self.description.scan or "")

    def file(self, name: str) -> Path:
        """The file that the description calls so; it need not exist."""
        beside = self.path.parent / name
        return beside if beside.exists() else self.folder / name


def described_in(folder: Path) -> list[Described]:
    """Every recording of the folder that a description in it, or one of the project's own, tells of.

    Raises `DescriptionError`, `CalibrationYamlError`; a description in the folder whose recording is missing is wrong.
    """
    paths = [path for path in sorted(folder.rglob(f"*{SUFFIX}")) if path.parent.resolve() != OURS.resolve()]
    theirs = [read_description(path, folder) for path in paths]
    for one in theirs:
        if not one.source.exists():
            raise DescriptionError(one.path, f"{one.source} is not there")
    ours = [read_description(path, folder) for path in own_descriptions()]
    return _of_one_name_each([*(one for one in ours if one.source.exists()), *theirs])


def own_descriptions() -> list[Path]:
    """Those that come with the project."""
    return sorted(OURS.glob(f"*{SUFFIX}"))


def read_description(path: Path, folder: Path) -> Described:
    """The description in this file. Raises `DescriptionError`, `CalibrationYamlError`."""
    if path.stat().st_size > MOST_BYTES:
        raise DescriptionError(path, f"has {path.stat().st_size} bytes; a description has at most {MOST_BYTES}")
    documents = parse_documents(path.name, path.read_bytes())
    if len(documents) != 1:
        raise DescriptionError(path, f"holds {len(documents)} documents; a description is one")
    try:
        return Described(Description.model_validate(documents[0]), path, folder)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the whole"
        raise DescriptionError(path, f"{where}: {first['msg']}") from None


def _of_one_name_each(found: list[Described]) -> list[Described]:
    """The same. Raises `DescriptionError` where two have one name: their labels would replace each other."""
    paths: dict[str, Path] = {}
    for one in found:
        name = one.description.name
        if name in paths:
            raise DescriptionError(one.path, f"is called {name!r}, and so is {paths[name]}; give it another name")
        paths[name] = one.path
    return found
