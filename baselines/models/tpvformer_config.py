"""The configuration of TPVFormer; the defaults are the official ones on the benchmark's grid.

Official: wzzheng/TPVFormer config/tpv04_occupancy.py, whose planes are 100 × 100 × 8 for another grid. The planes of
kitti_ssc/configs/tpv10_lr_wd_layer.py, for a grid of our shape and voxels, are half as fine as the grid: 128 × 128 ×
16, scaled up by 2. They are the default here, like the rest of the former file.
"""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice
from baselines.layers.pyramids import FPNConfig
from baselines.layers.resnet import ResNetConfig
from baselines.layers.tpv.aggregator import TPVAggregatorConfig
from baselines.layers.tpv.attention import PlaneAttentionConfig
from baselines.layers.tpv.encoder import TPVEncoderConfig

LEVELS = 4  # levels of image features for the attention


@dataclass(frozen=True)
class TPVFormerConfig:
    """`upscale`: the length of a plane's cell in voxels of the lattice. `cameras`: the exact number per frame.

    `anchors` of a cell of the top, front and side plane lie along its column. Images are sampled at `points` places
    around each anchor, and the top plane at 2 · `self_points` around each of its own cells. `grid_mask_probability`:
    the probability of a training step with partly blanked images. Class weights apply to the cross entropy.
    `backbone_…` are the fields of `ResNetConfig`: officially with frozen statistics, stem and first stage, for
    pretrained weights; without them, −1 and False.
    """

    architecture: Literal["tpvformer"] = "tpvformer"
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    upscale: int = 2
    cameras: int = 6
    channels: int = 256
    heads: int = 8
    anchors: tuple[int, int, int] = (4, 32, 32)
    points: int = 2
    self_points: int = 4
    layers: int = 3
    feedforward_channels: int = 512
    hidden_channels: int = 512
    dropout: float = 0.1
    grid_mask_probability: float = 0.7
    class_weights: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    backbone_depth: Literal[14, 26, 50, 101] = 101
    backbone_width: int = 64
    backbone_deformable_stages: tuple[bool, bool, bool, bool] = (False, False, True, True)
    backbone_style: Literal["pytorch", "caffe"] = "caffe"
    backbone_frozen_stages: int = 1
    backbone_norm_eval: bool = True
    checkpoint_gradients: bool = False

    def plane_lattice(self) -> VoxelLattice:
        return self.lattice.coarser(self.upscale)

    def backbone(self) -> ResNetConfig:
        return ResNetConfig(
            depth=self.backbone_depth,
            width=self.backbone_width,
            deformable_stages=self.backbone_deformable_stages,
            style=self.backbone_style,
            frozen_stages=self.backbone_frozen_stages,
            norm_eval=self.backbone_norm_eval,
            checkpoint_gradients=self.checkpoint_gradients,
        )

    def neck(self) -> FPNConfig:
        """Return the neck of the maps of strides 8, 16 and 32, and one of stride 64."""
        return FPNConfig(self.backbone().channels()[1:], self.channels, extra_levels=LEVELS - 3)

    def encoder(self) -> TPVEncoderConfig:
        attention = PlaneAttentionConfig(
            self.channels, self.heads, LEVELS, self.anchors, self.points, self.self_points, self.dropout
        )
        return TPVEncoderConfig(
            self.plane_lattice(),
            attention,
            self.layers,
            self.cameras,
            self.feedforward_channels,
            self.checkpoint_gradients,
        )

    def aggregator(self) -> TPVAggregatorConfig:
        return TPVAggregatorConfig(
            self.lattice, self.channels, self.hidden_channels, checkpoint_gradients=self.checkpoint_gradients
        )
