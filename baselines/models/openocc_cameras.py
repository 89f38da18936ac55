"""Camera branch of OpenOccupancy: pictures to a dense volume on the coarse lattice.

Source: `occ_plugin/occupancy/detectors/occnet.py`, `OccNet.extract_img_feat`; the configs' ResNet-50, SECONDFPN and
`ViewTransformerLiftSplatShootVoxel`. What differs is said in `layers/lifting.py` and `losses/depth.py`.
"""

from dataclasses import dataclass

from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from baselines.batch import Batch
from baselines.layers.depth_network import DepthNetwork, DepthNetworkConfig, camera_vectors
from baselines.layers.lifting import Frustum, lift
from baselines.layers.pyramids import SecondFPN
from baselines.layers.resnet import ResNet, ResNetConfig
from baselines.losses.depth import depth_divergence
from baselines.models.openocc_config import OpenOccConfig

UPSAMPLE_STRIDES = (0.25, 0.5, 1, 2)  # of maps at strides 4, 8, 16, 32, so that all come to 16
COARSEST_STRIDE = 32


@dataclass(frozen=True, eq=False)
class CameraVolume:
    """Voxels (B, C, x, y, z), features of pictures (B, N, C', h, w), probabilities of their depth (B, N, D, h, w).

    All None of a row without cameras.
    """

    voxels: Tensor | None = None
    image_features: Tensor | None = None
    depth_probabilities: Tensor | None = None


class CameraVoxelEncoder(nn.Module):
    """ResNet, neck, depth network, then each feature along its ray into the coarse lattice, weighed by depth."""

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
        """Raises `ValueError` without cameras, or with pictures whose sides are not multiples of 32 pixels."""
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
        """(B, N, C', H / 16, W / 16)."""
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
        """Of `depth_probabilities` against LiDAR's depth (B, N, H, W) m in the pictures, 0 where there is none."""
        return depth_divergence(probabilities, depth_m, self.frustum)


def resnet_config(config: OpenOccConfig) -> ResNetConfig:
    return ResNetConfig(
        depth=config.resnet_depth,
        width=config.resnet_width,
        frozen_stages=config.frozen_stages,
        checkpoint_gradients=config.checkpoint_gradients,
    )
