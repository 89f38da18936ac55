"""The architectures: the construction of a module from its configuration."""

from dataclasses import replace
from typing import Any, assert_never

from baselines.models.column_net import ColumnNet
from baselines.models.column_net_config import ColumnNetConfig
from baselines.models.occformer import OccFormer
from baselines.models.occformer_config import OccFormerConfig
from baselines.models.occfusion import OccFusion
from baselines.models.occfusion_config import OccFusionConfig
from baselines.models.occupancy_model import OccupancyModel
from baselines.models.openocc import OpenOcc
from baselines.models.openocc_config import OpenOccConfig
from baselines.models.tpvformer import TPVFormer
from baselines.models.tpvformer_config import TPVFormerConfig

ModelConfig = OpenOccConfig | TPVFormerConfig | OccFormerConfig | OccFusionConfig | ColumnNetConfig
ClassCounts = tuple[int, int, int, int]
LEAST_COUNT = 100  # lower limit of voxels of a class, which caps the weight of rare classes


def build_model(config: ModelConfig) -> OccupancyModel[Any]:
    """Return the model of a configuration, with weights drawn by torch's generator."""
    match config:
        case OpenOccConfig():
            return OpenOcc(config)
        case TPVFormerConfig():
            return TPVFormer(config)
        case OccFormerConfig():
            return OccFormer(config)
        case OccFusionConfig():
            return OccFusion(config)
        case ColumnNetConfig():
            return ColumnNet(config)
        case _:
            assert_never(config)


def with_class_counts(config: ModelConfig, voxels: ClassCounts) -> ModelConfig:
    """Return the configuration for a training split with these voxels of free, T, P and N, if its losses weight
    classes.

    TPVFormer and OccFusion weight all classes alike, as published; ColumnNet by its configuration.
    """
    free, t, p, n = (max(count, LEAST_COUNT) for count in voxels)
    if isinstance(config, OpenOccConfig | OccFormerConfig):
        return replace(config, class_counts=(free, t, p, n))
    return config
