"""Configurations of rows: inputs, model and training. YAML files, `configs/<row>.yaml`.

**Conventions.** A file contains only the differences from the defaults, which are the official ones. `architecture`
selects the model. Unknown keys are refused, because a misspelt key would train something else.
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
    """The training of a row. A step is `batch` · `accumulate` frames of each process.

    The learning rate rises for `warmup_steps` and falls by a cosine to a thousandth; for a pretrained image backbone it
    is `backbone_rate_ratio` of it. `stride`: train on every n-th frame of a sequence; all earlier sweeps are used.
    `counted`: the voxels of losses and the metric, like the benchmark's mask. Losses ignore occupied voxels with a
    confidence below `least_confidence`; validation scores count all.
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
            raise ValueError(f"a least_confidence of {self.least_confidence} is not a probability from 0 to 1")


@dataclass(frozen=True)
class RowConfig:
    """One row.

    `name` and `method` are its names in files and on a board, `reference` its paper, `grid` the grid of its labels: a
    name, or its record. The model's lattice is a part of the grid, by default all of it.
    """

    name: str
    method: str
    reference: str
    inputs: InputConfig
    model: Annotated[ModelConfig, Field(discriminator="architecture")]
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    grid: str | dict[str, Any] = PAPER.name

    def __post_init__(self) -> None:
        modality = getattr(self.model, "modality", self.inputs.modality)
        if modality != self.inputs.modality:
            raise ValueError(f"the modality of the inputs is {self.inputs.modality}, of the model {modality}")
        shape = getattr(self.model, "image_shape", self.inputs.image_size_px)
        if self.inputs.sees("C") and shape != self.inputs.image_size_px:
            raise ValueError(f"image_size_px is {self.inputs.image_size_px}, but the model requires {shape}")
        grid_part(self.model.lattice, self.label_grid)
        low_m, high_m = self.label_grid.min_m, self.label_grid.max_m
        for axis, ratio in enumerate((self.augment.mirror_x_ratio, self.augment.mirror_y_ratio)):
            if ratio > 0 and abs(low_m[axis] + high_m[axis]) > 1e-6:
                name = f"augment.mirror_{'xy'[axis]}_ratio"
                raise ValueError(f"the grid {self.label_grid} is not symmetric about the robot; set {name} to 0")

    @property
    def label_grid(self) -> LabelGrid:
        """Return the grid of its labels. Raises `ValueError`."""
        return _grid_of(self.grid)

    def as_json(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)


def _grid_of(grid: object) -> LabelGrid:
    try:
        return named_grid(grid) if isinstance(grid, str) else grid_of(grid)
    except Refused as error:
        raise ValueError(str(error)) from error


ROW: TypeAdapter[RowConfig] = TypeAdapter(RowConfig)


def known_rows() -> tuple[str, ...]:
    """Return the names of the shipped rows."""
    return tuple(sorted(path.stem for path in CONFIGS.glob("*.yaml")))


def read_row(name: str, changes: Mapping[str, Any] | None = None) -> RowConfig:
    """Return the row of this name or YAML file, with `changes` of its training. Raises `bad_row`."""
    path = CONFIGS / f"{name}.yaml" if name in known_rows() else Path(name)
    if not path.is_file():
        raise bad_row(name, "no row has this name", known_rows())
    if path.stat().st_size > MOST_CONFIG_BYTES:
        raise bad_row(name, f"the file is larger than {MOST_CONFIG_BYTES} bytes")
    try:
        mapping = YAML(typ="safe").load(path.read_text("utf-8"))
    except (YAMLError, UnicodeDecodeError) as error:
        raise bad_row(name, f"it is not YAML: {str(error).splitlines()[0]}") from error
    row = row_of(name, mapping)
    kept = {key: value for key, value in (changes or {}).items() if value is not None}
    return replace(row, training=replace(row.training, **kept))


def with_checkpointed_gradients(row: RowConfig) -> RowConfig:
    """Return the row with less memory for more time: the backward pass recomputes activations. Raises `bad_row`."""
    if isinstance(row.model, ColumnNetConfig):
        raise bad_row(row.name, "its blocks are too small for --checkpoint-gradients to help")
    return replace(row, model=replace(row.model, checkpoint_gradients=True))


def row_of(name: str, mapping: object) -> RowConfig:
    """Return the row of a mapping. Raises `bad_row`."""
    try:
        row = ROW.validate_python(_with_lattice(mapping))
    except ValidationError as error:
        first = error.errors()[0]
        field_path = ".".join(str(part) for part in first["loc"])
        why = first["msg"].removeprefix("Value error, ")  # pydantic's prefix of our own sentences
        raise bad_row(name, f"{field_path}: {why}, found {str(first['input'])[:80]!r}") from error
    unknown = next(_unknown_keys(mapping, row, ""), None)
    if unknown is not None:
        raise bad_row(name, f"{unknown} is not a field")
    return row


def _with_lattice(mapping: object) -> object:
    """Return the row's mapping; a grid without a lattice of the model gets the whole grid as lattice."""
    if not isinstance(mapping, Mapping) or "grid" not in mapping or not isinstance(mapping.get("model"), Mapping):
        return mapping
    try:
        lattice = asdict(VoxelLattice.of(_grid_of(mapping["grid"])))
    except ValueError:
        return mapping  # reading the row refuses the grid later
    return {**mapping, "model": {"lattice": lattice, **mapping["model"]}}


def _unknown_keys(mapping: object, value: object, path: str) -> Iterator[str]:
    """Yield the keys of a mapping that its dataclass lacks."""
    if not isinstance(mapping, Mapping) or not is_dataclass(value):
        return
    known = {field_info.name for field_info in fields(value)}
    for key, part in mapping.items():
        if key not in known:
            yield f"{path}{key}"
        else:
            yield from _unknown_keys(part, getattr(value, str(key)), f"{path}{key}.")


def bad_row(name: str, why: str, known: Sequence[str] = ()) -> Refused:
    hint = f"; available rows: {', '.join(known)}, or a path of a YAML file" if known else ""
    return Refused("bad_row", f"row {name!r}: {why}{hint}")
