"""OpenOccupancy's baselines and CoNet: cameras, LiDAR or both to a coarse volume, and with the cascade to a fine one.

Source: Wang et al., OpenOccupancy, ICCV 2023; official code `occ_plugin/occupancy/detectors/occnet.py`. Differences are
stated in their modules: norms (`layers/sparse_convolution.py`), positions of children (`openocc_cascade.py`), cells
with single occupied voxels (`losses/voxels.py`).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from baselines.batch import POINT_FEATURES, Batch
from baselines.lattice import VoxelLattice
from baselines.layers.depth_network import DepthNetwork, DepthNetworkConfig, camera_vectors
from baselines.layers.fpn3d import FPN3d
from baselines.layers.lifting import Frustum, lift
from baselines.layers.pyramids import SecondFPN
from baselines.layers.residual3d import ResNet3d
from baselines.layers.resnet import ResNet, ResNetConfig
from baselines.layers.sparse_convolution import SparseEncoder, means_of_points
from baselines.layers.visible_fusion import VisibleFusion
from baselines.losses.depth import depth_divergence
from baselines.losses.voxels import coarse_labels, cross_entropy, geometric_scale, lovasz_softmax, semantic_scale
from baselines.models.occupancy_model import CLASSES, OccupancyModel
from baselines.models.openocc_cascade import Cascade, FineVoxels
from baselines.models.openocc_config import OpenOccConfig
from baselines.models.openocc_head import SoftWeightedHead


@dataclass(frozen=True, eq=False)
class OpenOccOutputs:
    """Logits (B, 4, x, y, z) of coarse cells; refined voxels; depth from the cameras' encoder."""

    coarse: Tensor
    fine: FineVoxels | None = None
    depth_probabilities: Tensor | None = None


class OpenOcc(OccupancyModel[OpenOccOutputs]):
    """One of the six rows. With coarse ratio 4 they have the official numbers of parameters for four classes.

    C, L, M-OpenOcc: 97.3, 65.6, 123.4 M; C, L, M-CoNet: 116.1, 65.6, 123.5 M. At the default ratio 2 the sparse encoder
    is the official one of 4 ×, which has fewer channels: rows with LiDAR have 2.1 M parameters less.
    """

    def __init__(self, config: OpenOccConfig) -> None:
        super().__init__()
        self.config, self.lattice, self.modality = config, config.lattice, config.modality
        self.cameras = CameraVoxelEncoder(config) if config.has_cameras else None
        self.lidar = LidarVoxelEncoder(config) if config.has_lidar else None
        is_fused = config.has_cameras and config.has_lidar
        self.fusion = VisibleFusion(config.volume_channels) if is_fused else None
        self.residual = ResNet3d(config.volume_channels, config.residual_channels, config.residual_blocks)
        self.pyramid = FPN3d(config.residual_channels, config.pyramid_channels)
        self.residual.checkpoint_gradients = self.pyramid.checkpoint_gradients = config.checkpoint_gradients
        self.head = SoftWeightedHead(len(config.residual_channels), config.pyramid_channels, CLASSES)
        self.cascade = Cascade(config) if config.is_cascade else None
        weights = 1 / torch.log(torch.tensor(config.class_counts, dtype=torch.float32) + 0.001)
        self.register_buffer("class_weights", weights, persistent=False)
        self.class_weights: Tensor

    def forward(self, batch: Batch) -> OpenOccOutputs:
        seen = CameraVolume() if self.cameras is None else self.cameras(batch)
        measured = None if self.lidar is None else self.lidar(batch)
        volume = self.fused(seen.voxels, measured)
        coarse = self.head(self.pyramid(self.residual(volume)))
        fine = None if self.cascade is None else self.cascade(coarse, batch, seen.image_features)
        return OpenOccOutputs(coarse.logits, fine, seen.depth_probabilities)

    def fused(self, seen: Tensor | None, measured: Tensor | None) -> Tensor:
        """Return the fused volume of cameras and LiDAR."""
        if self.fusion is not None:
            return self.fusion(seen, measured)  # type: ignore[no-any-return]
        volume = measured if seen is None else seen
        if volume is None:
            raise ValueError(f"a row of modality {self.modality} has no sensor")
        return volume

    def losses(self, outputs: OpenOccOutputs, batch: Batch) -> dict[str, Tensor]:
        """Return four terms of coarse cells, four of refined voxels, and depth's if the batch has image depths.

        A term has its own value; its gradient is divided by that if the row's `normalises_losses`.
        """
        if batch.labels is None:
            raise ValueError("losses require labels, but this batch has none")
        with torch.autocast(batch.device.type, enabled=False):
            terms = voxel_terms("coarse", *self.supervised(outputs.coarse, batch.labels), self.class_weights)
            if outputs.fine is not None:
                labels = batch.labels[outputs.fine.indices.unbind(dim=1)]
                terms |= voxel_terms("fine", outputs.fine.logits, labels, None)
            depth_m = None if batch.cameras is None else batch.cameras.depth_m
            if self.cameras is not None and outputs.depth_probabilities is not None and depth_m is not None:
                depth = self.cameras.depth_loss(outputs.depth_probabilities, depth_m)
                terms["depth"] = self.config.depth_loss_weight * depth
            return {name: by_own_value(term) if self.config.normalises_losses else term for name, term in terms.items()}

    def supervised(self, coarse: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits and labels, both of coarse cells or, if the row `supervises_voxels`, both of voxels."""
        if self.config.supervises_voxels:
            return self.interpolated(coarse), labels
        return coarse, coarse_labels(labels, self.config.coarse_ratio)

    def logits(self, outputs: OpenOccOutputs, batch: Batch) -> Tensor:
        """Return the trilinear coarse logits; with the cascade, refined voxels have their own, other voxels their
        cell's: free.
        """
        if outputs.fine is None:
            return self.interpolated(outputs.coarse)
        logits = functional.interpolate(outputs.coarse.float(), size=self.lattice.shape, mode="nearest")
        frame, x, y, z = outputs.fine.indices.unbind(dim=1)
        logits[frame, :, x, y, z] = outputs.fine.logits.float()
        return logits

    def interpolated(self, coarse: Tensor) -> Tensor:
        """Return coarse logits, trilinear on the lattice, float32."""
        return functional.interpolate(coarse.float(), size=self.lattice.shape, mode="trilinear", align_corners=False)


def voxel_terms(name: str, logits: Tensor, labels: Tensor, class_weights: Tensor | None) -> dict[str, Tensor]:
    return {
        f"{name}_cross_entropy": cross_entropy(logits, labels, class_weights),
        f"{name}_semantic_scale": semantic_scale(logits, labels),
        f"{name}_geometric_scale": geometric_scale(logits, labels),
        f"{name}_lovasz": lovasz_softmax(logits, labels),
    }


def by_own_value(term: Tensor) -> Tensor:
    """Return the term with its gradient divided by its value, like the gradient of its logarithm.

    OpenOccupancy's `loss_norm` minimises term / value, with the same gradient, but a value of always 1 in logs.
    """
    value = term.detach()
    return value + (term - value) / (value + 1e-9)


# LiDAR branch of OpenOccupancy: sweeps to a dense volume on the coarse lattice. Source:
# `occ_plugin/occupancy/detectors/occnet.py`, `OccNet.extract_pts_feat`, with the configs' 0.1 m voxels.


COLUMNS = tuple(POINT_FEATURES.index(name) for name in ("x", "y", "z", "age_s"))


class LidarVoxelEncoder(nn.Module):
    """Means of x, y, z and age in small voxels, then sparse convolutions down to the coarse lattice."""

    def __init__(self, config: OpenOccConfig) -> None:
        super().__init__()
        self.lattice = lattice_of_points(config)
        ratio = self.lattice.shape[0] // config.coarse_lattice.shape[0]
        self.encoder = SparseEncoder(len(COLUMNS), config.sparse_channels, config.volume_channels, ratio)

    def forward(self, batch: Batch) -> Tensor:
        """Return (B, volume_channels, x, y, z). Raises `ValueError` without LiDAR."""
        if batch.lidar is None:
            raise ValueError("this batch has no LiDAR")
        with torch.autocast(batch.device.type, enabled=False):
            features = batch.lidar.features[:, COLUMNS].float()
            voxels = means_of_points(batch.lidar, features, self.lattice, len(batch))
        volume: Tensor = self.encoder(voxels)
        return volume


def lattice_of_points(config: OpenOccConfig) -> VoxelLattice:
    """Return the same volume in voxels of `lidar_voxel_m`. Raises `ValueError` if they do not divide a coarse cell."""
    coarse, size = config.coarse_lattice, config.lidar_voxel_m
    ratios = [round(length / size) for length in coarse.voxel_m]
    if any(abs(length - size * n) > 1e-6 * length for length, n in zip(coarse.voxel_m, ratios, strict=True)):
        raise ValueError(f"coarse cells of {coarse.voxel_m} m are not whole numbers of voxels of {size} m")
    x, y, z = (cells * n for cells, n in zip(coarse.shape, ratios, strict=True))
    return VoxelLattice(coarse.min_m, (size, size, size), (x, y, z))


# Camera branch of OpenOccupancy: images to a dense volume on the coarse lattice. Source:
# `occ_plugin/occupancy/detectors/occnet.py`, `OccNet.extract_img_feat`; the configs' ResNet-50, SECONDFPN and
# `ViewTransformerLiftSplatShootVoxel`. Differences are stated in `layers/lifting.py` and `losses/depth.py`.


UPSAMPLE_STRIDES = (0.25, 0.5, 1, 2)  # brings maps at strides 4, 8, 16, 32 all to 16
COARSEST_STRIDE = 32


@dataclass(frozen=True, eq=False)
class CameraVolume:
    """Voxels (B, C, x, y, z), features of images (B, N, C', h, w), probabilities of their depth (B, N, D, h, w).

    All None in a row without cameras.
    """

    voxels: Tensor | None = None
    image_features: Tensor | None = None
    depth_probabilities: Tensor | None = None


class CameraVoxelEncoder(nn.Module):
    """ResNet, neck, depth network, then each feature along its ray into the coarse lattice, weighted by depth."""

    def __init__(self, config: OpenOccConfig) -> None:
        super().__init__()
        backbone = resnet_config(config)
        self.lattice, self.checkpoints = config.coarse_lattice, config.checkpoint_gradients
        self.frustum = Frustum(*config.depth_range_m, config.depth_step_m)
        self.backbone = ResNet(backbone)
        self.neck = SecondFPN(backbone.channels(), config.neck_channels, UPSAMPLE_STRIDES)
        self.depth = DepthNetwork(
            DepthNetworkConfig(
                in_channels=config.image_channels,
                mid_channels=config.image_channels,
                context_channels=config.volume_channels,
                depth_bins=self.frustum.bins,
                dropout=config.depth_dropout,
            )
        )

    def forward(self, batch: Batch) -> CameraVolume:
        """Return the camera volume. Raises `ValueError` without cameras, or if image sides are not multiples of 32
        pixels.
        """
        features = self.image_features(batch)
        depth, context = self.depth(features.flatten(0, 1), camera_vectors(batch).flatten(0, 1))
        size = features.shape[:2]
        points = self.frustum.points_of(batch, (features.shape[3], features.shape[4]))
        lifted = depth.view(*size, *depth.shape[1:]), context.view(*size, *context.shape[1:]), points, self.lattice
        if self.checkpoints and self.training:
            voxels, probabilities = checkpoint(lift, *lifted, use_reentrant=False)
        else:
            voxels, probabilities = lift(*lifted)
        return CameraVolume(voxels, features, probabilities)

    def image_features(self, batch: Batch) -> Tensor:
        """Return (B, N, C', H / 16, W / 16)."""
        if batch.cameras is None:
            raise ValueError("this batch has no cameras")
        images = batch.cameras.images
        if any(side % COARSEST_STRIDE for side in images.shape[3:]):
            raise ValueError(
                f"pictures of {images.shape[3]} × {images.shape[4]} px, not multiples of {COARSEST_STRIDE}"
            )
        features: Tensor = self.neck(self.backbone(images.flatten(0, 1)))
        return features.view(*images.shape[:2], *features.shape[1:])

    def depth_loss(self, probabilities: Tensor, depth_m: Tensor) -> Tensor:
        """Return the loss of `depth_probabilities` against LiDAR's depth (B, N, H, W) m; 0 is no depth."""
        return depth_divergence(probabilities, depth_m, self.frustum)


def resnet_config(config: OpenOccConfig) -> ResNetConfig:
    return ResNetConfig(
        depth=config.resnet_depth,
        width=config.resnet_width,
        frozen_stages=config.frozen_stages,
        checkpoint_gradients=config.checkpoint_gradients,
    )
