"""OccFormer: images lifted to a volume, dual-path transformer blocks, and queries that become masks with a class.

**Conventions.** Volumes and masks are on the lattice `coarse_ratio` times as coarse as the model's, as in the official
code. A prediction's masks are resampled trilinearly to the lattice before they become probabilities; losses read the
masks trilinearly at voxels of the lattice, so that labels are never made coarser.

Source: Zhang et al., OccFormer, ICCV 2023; zhangyp15/OccFormer, occformer/detectors/occupancyformer.py. The head is
SemanticKITTI's (mask2former_occ.py), since the nuScenes head learns from points labelled in LiDAR sweeps.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from baselines.batch import Batch
from baselines.lattice import Shape
from baselines.layers.depth_network import DepthNetwork, camera_vectors
from baselines.layers.dual_path import DualPathEncoder
from baselines.layers.lifting import lift
from baselines.layers.masked_attention import MaskDecoder, MaskPrediction
from baselines.layers.pixel_decoder3d import PixelDecoder3D
from baselines.layers.pyramids import SecondFPN
from baselines.layers.resnet import ResNet
from baselines.losses.depth import depth_cross_entropy
from baselines.losses.masks import mask_losses
from baselines.models.occformer_config import SCALES, OccFormerConfig
from baselines.models.occupancy_model import OccupancyModel

COARSEST_STRIDE = 32  # the backbone's maps, in pixels
QUERIES_AT_ONCE = 20  # queries whose masks are resampled together: 8 MB each on the benchmark's grid


@dataclass(frozen=True, eq=False)
class OccFormerOutputs:
    """The queries' predictions at first and after each layer; probabilities (B, N, D, h, w) of the images' depth."""

    predictions: tuple[MaskPrediction, ...]
    depth: Tensor


class OccFormer(OccupancyModel[OccFormerOutputs]):
    """Cameras to masks. An image's height and width are multiples of 32.

    At full size it has 167,770,683 parameters, like the official modules at 4 classes (167.8 M). The parts are backbone
    44,304,894, neck 1,967,104, depth network 27,842,360, encoder 81,429,184, pixel decoder 4,073,280, mask decoder
    8,153,861. With ResNet-50 146,973,821 (147.0 M). The official frustum, voxel sizes and the like are untrained
    parameters there, and no parameters here.
    """

    modality = "C"

    def __init__(self, config: OccFormerConfig) -> None:
        super().__init__()
        self.config, self.lattice = config, config.lattice
        self.coarse_lattice, self.frustum = config.coarse_lattice(), config.frustum()
        self.backbone = ResNet(config.backbone())
        self.neck = SecondFPN(config.backbone().channels(), (config.neck_channels,) * len(SCALES), SCALES)
        self.depth_network = DepthNetwork(config.depth_network())
        self.encoder = DualPathEncoder(config.encoder())
        self.pixel_decoder = PixelDecoder3D(config.pixel_decoder())
        self.mask_decoder = MaskDecoder(config.mask_decoder())
        for module in self.backbone.modules():
            if config.backbone_norm_eval and isinstance(module, nn.BatchNorm2d):
                module.requires_grad_(requires_grad=False)

    def forward(self, batch: Batch) -> OccFormerOutputs:
        volume, depth = self.lifted(batch)
        features, memories = self.pixel_decoder(self.encoder(volume))
        return OccFormerOutputs(self.mask_decoder(features, memories), depth)

    def lifted(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the volume lifted from the images, on the coarse lattice, and the probabilities of depth."""
        if batch.cameras is None:
            raise ValueError("OccFormer requires cameras, but this batch has none")
        images = batch.cameras.images
        if any(side % COARSEST_STRIDE for side in images.shape[3:]):
            raise ValueError(
                f"pictures of {tuple(images.shape[3:])} pixels, whose sides are not multiples of {COARSEST_STRIDE}"
            )
        features = self.neck(self.backbone(images.flatten(0, 1)))
        logits, context = self.depth_network(features, camera_vectors(batch).flatten(0, 1))
        points = self.frustum.points_of(batch, (features.shape[2], features.shape[3]))
        views = images.shape[:2]
        seen = (logits.unflatten(0, views), context.unflatten(0, views), points, self.coarse_lattice)
        if self.config.checkpoint_gradients and self.training:
            return checkpoint(lift, *seen, use_reentrant=False)  # type: ignore[no-any-return]
        return lift(*seen)

    def losses(self, outputs: OccFormerOutputs, batch: Batch) -> dict[str, Tensor]:
        """Return `class`, `mask` and `dice` of all predictions, and `depth` if the batch has image depths."""
        if batch.labels is None:
            raise ValueError("losses require labels, but this batch has none")
        terms = mask_losses(outputs.predictions, batch.labels, self.config.mask_loss())
        if batch.cameras is not None and batch.cameras.depth_m is not None:
            depth = depth_cross_entropy(outputs.depth, batch.cameras.depth_m, self.frustum)
            terms["depth"] = self.config.depth_loss_weight * depth
        return terms

    def logits(self, outputs: OccFormerOutputs, batch: Batch) -> Tensor:
        """Return the logarithms of the class shares from the masks of the last queries."""
        return class_logits(outputs.predictions[-1], self.lattice.shape, self.config.align_corners)


def class_logits(prediction: MaskPrediction, shape: Shape, align_corners: bool) -> Tensor:
    """Return (B, C, X, Y, Z) float32: ln Σ over queries of P(class) · P(mask), the masks resampled to `shape`."""
    with torch.autocast(prediction.masks.device.type, enabled=False):
        speaking = prediction.classes.float().softmax(dim=2)[:, :, :-1]
        scores = speaking.new_zeros(len(speaking), speaking.shape[2], *shape)
        for start in range(0, speaking.shape[1], QUERIES_AT_ONCE):
            some = slice(start, start + QUERIES_AT_ONCE)
            masks = functional.interpolate(
                prediction.masks[:, some].float(), size=shape, mode="trilinear", align_corners=align_corners
            )
            scores += torch.einsum("bqc,bqxyz->bcxyz", speaking[:, some], masks.sigmoid())
        return scores.clamp_min(torch.finfo(torch.float32).tiny).log()
