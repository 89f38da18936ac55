"""OccFusion: camera features projected on voxels, points encoded in them, fused at three scales, decoded at four.

Written from the paper, because its code has no licence. Backbone, pyramid and heads have exactly the official numbers
of parameters. The paper omits the widths between them; with ours C has 67.22 M (official 67.04), C+R 91.87 M (92.57),
C+L 127.99 M (126.46). The difference is in the volumes of points and their fusions. Source: Ming et al., OccFusion:
Multi-Sensor Fusion Framework for 3D Semantic Occupancy Prediction, IEEE T-IV 2024.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from baselines.batch import POINT_FEATURES, RADAR_FEATURES, Batch, CameraViews, Points
from baselines.lattice import VoxelLattice
from baselines.layers.camera_projection import ProjectedFeatures, project_features
from baselines.layers.efficient_vit import GlobalLocalFusion
from baselines.layers.pyramids import FPN, FPNConfig
from baselines.layers.resnet import ResNet, ResNetConfig
from baselines.layers.sensor_fusion import DynamicFusion2d, DynamicFusion3d, unit3d
from baselines.layers.visible_fusion import VisibleFusion
from baselines.layers.voxel_features import PointVolumes
from baselines.losses.voxels import coarse_labels, focal_loss, geometric_scale, lovasz_softmax, semantic_scale
from baselines.models.occfusion_config import OccFusionConfig
from baselines.models.occupancy_model import CLASSES, OccupancyModel

SCALES = (2, 4, 8)  # ratios of the fused volumes' cells to the lattice's voxels


class CameraVolumes(nn.Module):
    """Images to a volume and a map on each of the lattices of `SCALES`."""

    def __init__(self, config: OccFusionConfig) -> None:
        super().__init__()
        backbone = ResNetConfig(
            depth=config.resnet_depth,
            width=config.resnet_width,
            deformable_stages=config.deformable_stages,
            frozen_stages=config.frozen_stages,
            norm_eval=config.norm_eval,
            checkpoint_gradients=config.checkpoint_gradients,
        )
        self.lattices = [config.lattice.coarser(ratio) for ratio in SCALES]
        self.backbone = ResNet(backbone)
        self.pyramid = FPN(FPNConfig(backbone.channels()[1:], config.pyramid_channels))
        self.narrow = nn.ModuleList(nn.Conv2d(config.pyramid_channels, n, 1) for n in config.level_channels[1:])

    def forward(self, views: CameraViews, grid_from_camera: Tensor) -> list[ProjectedFeatures]:
        maps = self.pyramid(self.backbone(views.images.flatten(0, 1))[1:])
        features = [
            conv(each).unflatten(0, views.images.shape[:2]) for conv, each in zip(self.narrow, maps, strict=True)
        ]
        return [
            project_features(each, views, grid_from_camera, lattice)
            for each, lattice in zip(features, self.lattices, strict=True)
        ]


class PointFusion(nn.Module):
    """One scale's camera features fused with point features: volumes by `volumes`, maps by channel excitation."""

    def __init__(self, channels: int, volumes: nn.Module) -> None:
        super().__init__()
        self.volumes = volumes
        self.maps = DynamicFusion2d(channels)

    def forward(self, camera: ProjectedFeatures, points: Tensor) -> ProjectedFeatures:
        return ProjectedFeatures(self.volumes(camera.volume, points), self.maps(camera.bev, points.amax(dim=4)))


class OccupancyDecoder(nn.Module):
    """Volumes at `SCALES`, finest first, to logits of the lattice and of each scale, finest first."""

    def __init__(self, channels: tuple[int, ...], *, checkpoint_gradients: bool) -> None:
        super().__init__()
        self.checkpoint_gradients = checkpoint_gradients
        self.upsamplings = nn.ModuleList(nn.ConvTranspose3d(coarse, fine, 2, 2) for fine, coarse in pairwise(channels))
        self.merges = nn.ModuleList(unit3d(width, width, 3) for width in channels[:-1])
        self.heads = nn.ModuleList(voxel_classifier(width) for width in channels)

    def forward(self, volumes: Sequence[Tensor]) -> list[Tensor]:
        features = volumes[-1]
        answers = [self.heads[-1](features)]
        for level in range(len(volumes) - 1, -1, -1):
            skip = volumes[level - 1] if level else None
            features = self._finer(level, features, skip)
            answers.append(self.heads[level](features))
        return answers[::-1]

    def _finer(self, level: int, features: Tensor, skip: Tensor | None) -> Tensor:
        def step(coarse: Tensor) -> Tensor:
            fine = self.upsamplings[level](coarse)
            return cast("Tensor", self.merges[level](fine if skip is None else fine + skip))

        if self.checkpoint_gradients and self.training:
            return cast("Tensor", checkpoint(step, features, use_reentrant=False))
        return step(features)


class OccFusion(OccupancyModel[list[Tensor]]):
    """Outputs are logits (B, 4, X, Y, Z) of the lattice and of lattices 2, 4 and 8 times coarser."""

    def __init__(self, config: OccFusionConfig) -> None:
        super().__init__()
        self.config, self.lattice, self.modality = config, config.lattice, config.modality
        channels = config.level_channels
        self.cameras = CameraVolumes(config)
        self.points = nn.ModuleDict()
        self.fusions = nn.ModuleDict()
        finest = config.lattice.coarser(SCALES[0])
        if "L" in config.modality:
            gates = [VisibleFusion(width) for width in channels[1:]]
            self._add_points("lidar", len(POINT_FEATURES), gates, finest)
        if "R" in config.modality:
            fusions = [DynamicFusion3d(width) for width in channels[1:]]
            self._add_points("radar", len(RADAR_FEATURES), fusions, finest)
        self.contexts = nn.ModuleList(
            GlobalLocalFusion(width, min(config.head_channels, width), config.atrous_rates) for width in channels[1:]
        )
        self.decoder = OccupancyDecoder(channels, checkpoint_gradients=config.checkpoint_gradients)

    def forward(self, batch: Batch) -> list[Tensor]:
        if batch.cameras is None:
            raise ValueError("OccFusion requires cameras, but this batch has none")
        scales: list[ProjectedFeatures] = self.cameras(batch.cameras, batch.grid_from_camera())
        for name in self.points:
            volumes = self.points[name](points_of(batch, name), len(batch))
            fusions = cast("nn.ModuleList", self.fusions[name])
            scales = [fuse(*pair) for fuse, pair in zip(fusions, zip(scales, volumes, strict=True), strict=True)]
        contexts = zip(self.contexts, scales, strict=True)
        return cast("list[Tensor]", self.decoder([fuse(scale.volume, scale.bev) for fuse, scale in contexts]))

    def losses(self, outputs: list[Tensor], batch: Batch) -> dict[str, Tensor]:
        if batch.labels is None:
            raise ValueError("this batch has no labels")
        terms: dict[str, Tensor] = {}
        for ratio, weight, logits in zip((1, *SCALES), self.config.level_weights, outputs, strict=True):
            for name, term in self._level_losses(logits.float(), coarse_labels(batch.labels, ratio)).items():
                terms[name] = terms.get(name, logits.new_zeros((), dtype=torch.float32)) + weight * term
        return terms

    def logits(self, outputs: list[Tensor], batch: Batch) -> Tensor:
        return outputs[0].float()

    def _add_points(self, name: str, features: int, fusions: Sequence[nn.Module], finest: VoxelLattice) -> None:
        channels = self.config.level_channels[1:]
        self.points[name] = PointVolumes(features, self.config.point_widths, channels, finest)
        self.fusions[name] = nn.ModuleList(
            PointFusion(width, fusion) for width, fusion in zip(channels, fusions, strict=True)
        )

    def _level_losses(self, logits: Tensor, labels: Tensor) -> dict[str, Tensor]:
        with torch.autocast(logits.device.type, enabled=False):
            return {
                "focal": focal_loss(logits, labels, self.config.focal_gamma, self.config.focal_alpha),
                "geometric": geometric_scale(logits, labels),
                "semantic": semantic_scale(logits, labels),
                "lovasz": lovasz_softmax(logits, labels),
            }


def points_of(batch: Batch, name: str) -> Points:
    """Return the batch's `lidar` or `radar`. Raises `ValueError` if it is absent."""
    points = batch.lidar if name == "lidar" else batch.radar
    if points is None:
        raise ValueError(f"this model requires {name}, but this batch has none")
    return points


def voxel_classifier(width: int) -> nn.Sequential:
    """Return two hidden layers of a voxel's own features, then the classes."""
    return nn.Sequential(
        nn.Conv3d(width, width, 1),
        nn.ReLU(inplace=True),
        nn.Conv3d(width, width, 1),
        nn.ReLU(inplace=True),
        nn.Conv3d(width, CLASSES, 1),
    )
