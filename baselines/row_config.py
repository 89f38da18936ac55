"""Configurations of rows: what a row looks at, what it is made of, how it is trained. YAML files, `configs/<row>.yaml`.

**Conventions.** A file says what differs from the defaults, which are the official ones. Which model it is of, its
`architecture` says. Unknown keys are refused: a misspelt one would train something else.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from baselines.augment import AugmentConfig
from baselines.inputs import CountedVoxels, InputConfig, refuse_below_one
from baselines.lattice import VoxelLattice, grid_part
from baselines.models.architectures import ModelConfig
from baselines.models.column_net_config import ColumnNetConfig
from stone.errors import Refused
from stone_base.label_grid import PAPER, LabelGrid, grid_of, named_grid

CONFIGS = Path(__file__).with_name("configs")
MOST_CONFIG_BYTES = 65536


@dataclass(frozen=True)
class TrainingConfig:
    """How a row is trained. A step is `batch` · `accumulate` frames of each process.

    The learning rate rises for `warmup_steps` and falls by a cosine to a thousandth; that of a pretrained image
    backbone is `backbone_rate_ratio` of it. `stride`: every n-th frame of a sequence is trained on; earlier sweeps are
    all used. `counted`: the voxels that losses and the metric count, as the benchmark's mask has it. Losses ignore
    occupied voxels whose label is right with a probability below `least_confidence`; what is watched is scored whole.
    """

    epochs: int = 24
    batch: int = 1
    accumulate: int = 1
    learning_rate: float = 2e-4
    weight_decay: float = 0.01
    warmup_steps: int = 500
    clip_norm: float = 35.0
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    backbone_rate_ratio: float = 1.0
    stride: int = 1
    counted: CountedVoxels = "all"
    least_confidence: float = 0.0
    seed: int = 0
    checkpoint_steps: int = 250

    def __post_init__(self) -> None:
        refuse_below_one(self, "epochs", "batch", "accumulate", "stride", "checkpoint_steps")
        if self.learning_rate < 0:
            raise ValueError(f"a learning_rate of {self.learning_rate} is negative")
        if not 0 <= self.least_confidence <= 1:
            raise ValueError(f"a least_confidence of {self.least_confidence} is no probability from 0 to 1")


@dataclass(frozen=True)
class RowConfig:
    """One row. `name` and `method` are what the files and a board call it, `reference` its paper, `grid` the grid of
    its labels: a name, or the record of one; the model's lattice is a part of it, and all of it if none is named."""

    name: str
    method: str
    reference: str
    inputs: InputConfig
    model: Annotated[ModelConfig, Field(discriminator="architecture")]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    grid: str | dict[str, Any] = PAPER.name

    def __post_init__(self) -> None:
        said = getattr(self.model, "modality", self.inputs.modality)
        if said != self.inputs.modality:
            raise ValueError(f"inputs are of {self.inputs.modality}, the model of {said}")
        shape = getattr(self.model, "image_shape", self.inputs.image_size_px)
        if self.inputs.sees("C") and shape != self.inputs.image_size_px:
            raise ValueError(f"pictures of {self.inputs.image_size_px} are given, the model is made for {shape}")
        grid_part(self.model.lattice, self.label_grid)
        low_m, high_m = self.label_grid.min_m, self.label_grid.max_m
        for axis, ratio in enumerate((self.augment.mirror_x_ratio, self.augment.mirror_y_ratio)):
            if ratio > 0 and abs(low_m[axis] + high_m[axis]) > 1e-6:
                name = f"augment.mirror_{'xy'[axis]}_ratio"
                raise ValueError(f"the grid {self.label_grid} is not symmetric about the robot; set {name} to 0")

    @property
    def label_grid(self) -> LabelGrid:
        """The grid of its labels. Raises `ValueError`."""
        return _grid_of(self.grid)

    def as_json(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)


def _grid_of(said: object) -> LabelGrid:
    try:
        return named_grid(said) if isinstance(said, str) else grid_of(said)
    except Refused as error:
        raise ValueError(str(error)) from error


ROW: TypeAdapter[RowConfig] = TypeAdapter(RowConfig)


def known_rows() -> tuple[str, ...]:
    """Names of the rows that are shipped."""
    return tuple(sorted(path.stem for path in CONFIGS.glob("*.yaml")))


def read_row(name: str, changes: Mapping[str, Any] | None = None) -> RowConfig:
    """The row of this name, or of this YAML file, with `changes` of its training. Raises `bad_row`."""
    path = CONFIGS / f"{name}.yaml" if name in known_rows() else Path(name)
    if not path.is_file():
        raise bad_row(name, "there is no such row", known_rows())
    if path.stat().st_size > MOST_CONFIG_BYTES:
        raise bad_row(name, f"the file is larger than {MOST_CONFIG_BYTES} bytes")
    try:
        said = YAML(typ="safe").load(path.read_text("utf-8"))
    except (YAMLError, UnicodeDecodeError) as error:
        raise bad_row(name, f"it is not YAML: {str(error).splitlines()[0]}") from error
    row = row_of(name, said)
    kept = {key: value for key, value in (changes or {}).items() if value is not None}
    return replace(row, training=replace(row.training, **kept))


def with_checkpointed_gradients(row: RowConfig) -> RowConfig:
    """The row with less memory for more time: activations are computed anew in backward. Raises `bad_row`."""
    if isinstance(row.model, ColumnNetConfig):
        raise bad_row(row.name, "it has no blocks large enough for --checkpoint-gradients to be of use")
    return replace(row, model=replace(row.model, checkpoint_gradients=True))


def row_of(name: str, said: object) -> RowConfig:
    """The row that a mapping describes. Raises `bad_row`."""
    try:
        row = ROW.validate_python(_with_lattice(said))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        why = first["msg"].removeprefix("Value error, ")  # pydantic's, before a sentence of our own
        raise bad_row(name, f"{place}: {why}, found {str(first['input'])[:80]!r}") from error
    unknown = next(_unknown_keys(said, row, ""), None)
    if unknown is not None:
        raise bad_row(name, f"{unknown} is not a field")
    return row


def _with_lattice(said: object) -> object:
    """A row that names a grid, and no lattice of its model, with all of the grid as that."""
    if not isinstance(said, Mapping) or "grid" not in said or not isinstance(said.get("model"), Mapping):
        return said
    try:
        lattice = asdict(VoxelLattice.of(_grid_of(said["grid"])))
    except ValueError:
        return said  # reading the row refuses the grid in its place
    return {**said, "model": {"lattice": lattice, **said["model"]}}


def _unknown_keys(said: object, value: object, path: str) -> Iterator[str]:
    """Keys of a mapping that the dataclass made of it does not have."""
    if not isinstance(said, Mapping) or not is_dataclass(value):
        return
    known = {one.name for one in fields(value)}
    for key, part in said.items():
        if key not in known:
            yield f"{path}{key}"
        else:
            yield from _unknown_keys(part, getattr(value, str(key)), f"{path}{key}.")


def bad_row(name: str, why: str, known: Sequence[str] = ()) -> Refused:
    hint = f"; the rows that are there: {', '.join(known)}, or a path of a YAML file" if known else ""
    return Refused("bad_row", f"row {name!r}: {why}{hint}")
