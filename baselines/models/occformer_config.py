"""The configuration of OccFormer; the defaults are the official ones on the benchmark's grid.

Source: zhangyp15/OccFormer, projects/configs/occformer_nusc/occformer_nusc_r101_896x1600.py, whose grid has the shape
of ours; for its head, occformer_kitti/occformer_kitti.py, whose grid has our voxels too.
"""

from dataclasses import dataclass, field
from typing import Literal

from baselines.lattice import VoxelLattice
from baselines.layers.deformable_attention3d import DeformableSettings3D
from baselines.layers.depth_network import DepthNetworkConfig
from baselines.layers.dual_path import DualPathSettings
from baselines.layers.lifting import Frustum
from baselines.layers.masked_attention import QuerySettings
from baselines.layers.pixel_decoder3d import PixelDecoderSettings
from baselines.layers.resnet import ResNetConfig
from baselines.layers.shifted_windows import WindowSettings
from baselines.losses.masks import MaskLossSettings, PointSettings
from baselines.models.occupancy_model import CLASSES

SCALES = (0.25, 0.5, 1.0, 2.0)  # scales the backbone's four maps to a sixteenth of the image
STRIDE = 16


@dataclass(frozen=True)
class OccFormerConfig:
    """`coarse_ratio`: the length of a cell of all volumes and masks in voxels of the lattice.

    `backbone_…` are the fields of `ResNetConfig`: officially with frozen statistics, stem and first stage, for
    pretrained weights; without them, −1 and False. `stage_channels` start with the lifted channels, and are multiples
    of `head_channels`; `decoder_channels` is a multiple of 6 and of both numbers of heads. `class_counts` are the
    labelled voxels of free, T, P and N in the training split, here of ten frames of a simulated world. `mask_points` is
    the number of sampled voxels of the lattice per mask loss.
    """

    architecture: Literal["occformer"] = "occformer"
    lattice: VoxelLattice = field(default_factory=VoxelLattice)
    coarse_ratio: int = 2
    backbone_depth: Literal[14, 26, 50, 101] = 101
    backbone_width: int = 64
    backbone_deformable_stages: tuple[bool, bool, bool, bool] = (False, False, True, True)
    backbone_style: Literal["pytorch", "caffe"] = "caffe"
    backbone_frozen_stages: int = 1
    backbone_norm_eval: bool = True
    neck_channels: int = 128  # per map
    depth_range_m: tuple[float, float] = (2.0, 58.0)
    depth_step_m: float = 0.5
    depth_dropout: float = 0.5
    stage_channels: tuple[int, int, int, int] = (128, 256, 512, 1024)
    stage_blocks: tuple[int, int, int, int] = (2, 2, 2, 2)
    window: int = 7
    head_channels: int = 32
    drop_path: float = 0.2
    context_dropout: float = 0.1
    decoder_channels: int = 192
    pixel_layers: int = 6
    pixel_heads: int = 8
    queries: int = 100
    query_layers: int = 9
    query_heads: int = 6
    class_counts: tuple[int, int, int, int] = (20_510_000, 2_900, 120_000, 336_000)
    mask_points: int = 4 * 12_544
    align_corners: bool = True  # masks and lattice: `PointSettings`
    depth_loss_weight: float = 1.0
    checkpoint_gradients: bool = False

    def coarse_lattice(self) -> VoxelLattice:
        return self.lattice.coarser(self.coarse_ratio)

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

    def frustum(self) -> Frustum:
        return Frustum(*self.depth_range_m, self.depth_step_m, STRIDE)

    def depth_network(self) -> DepthNetworkConfig:
        width = self.neck_channels * len(SCALES)
        return DepthNetworkConfig(width, width, self.stage_channels[0], self.frustum().bins, self.depth_dropout)

    def encoder(self) -> DualPathSettings:
        windows = WindowSettings(self.window, self.head_channels, self.drop_path)
        return DualPathSettings(
            inputs=self.stage_channels[0],
            channels=self.stage_channels,
            blocks=self.stage_blocks,
            windows=windows,
            dropout=self.context_dropout,
            checkpoint_gradients=self.checkpoint_gradients,
        )

    def pixel_decoder(self) -> PixelDecoderSettings:
        return PixelDecoderSettings(
            inputs=self.stage_channels,
            attention=DeformableSettings3D(self.decoder_channels, self.pixel_heads),
            layers=self.pixel_layers,
            hidden=4 * self.decoder_channels,
            checkpoint_gradients=self.checkpoint_gradients,
        )

    def mask_decoder(self) -> QuerySettings:
        return QuerySettings(
            classes=CLASSES,
            queries=self.queries,
            channels=self.decoder_channels,
            heads=self.query_heads,
            layers=self.query_layers,
            hidden=8 * self.decoder_channels,
        )

    def mask_loss(self) -> MaskLossSettings:
        points = PointSettings(points=self.mask_points, align_corners=self.align_corners)
        return MaskLossSettings(class_counts=self.class_counts, points=points)


def official_r50() -> OccFormerConfig:
    """Return the official smaller configuration: ResNet-50, trained except for its stem, on 256 × 704 pixels."""
    return OccFormerConfig(
        backbone_depth=50,
        backbone_deformable_stages=(False, False, False, False),
        backbone_style="pytorch",
        backbone_frozen_stages=0,
        backbone_norm_eval=False,
    )
