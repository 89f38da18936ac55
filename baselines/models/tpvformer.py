"""TPVFormer, the camera row without depth: three planes of queries attend to the images, voxels sum the planes.

Source: Huang et al., Tri-Perspective View for Vision-Based 3D Semantic Occupancy Prediction, CVPR 2023;
wzzheng/TPVFormer tpvformer10/tpvformer.py, config/tpv04_occupancy.py and train.py (its losses).
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.batch import Batch
from baselines.layers.grid_mask import GridMask
from baselines.layers.pyramids import FPN
from baselines.layers.resnet import ResNet
from baselines.layers.tpv.aggregator import TPVAggregator
from baselines.layers.tpv.camera_sight import CameraRig
from baselines.layers.tpv.encoder import TPVEncoder
from baselines.losses.voxels import cross_entropy, lovasz_softmax
from baselines.models.occupancy_model import OccupancyModel
from baselines.models.tpvformer_config import TPVFormerConfig

STRIDE = 32  # images are padded to multiples of it (official)


class TPVFormer(OccupancyModel[Tensor]):
    """Outputs are the logits (B, 4, X, Y, Z).

    At full size it has 65,070,146 parameters, like the official modules at 4 classes and planes of 128 × 128 × 16 (65.1
    M). The parts are backbone 44,304,894, pyramid 3,278,592, queries 5,242,880, positions 32,768, embeddings of cameras
    and levels 2,560. Further parts are three encoder layers of 3,981,504 and the aggregator 263,940. With batch
    normalisation, stem and first stage frozen, as officially, 64,742,402 of them are trained.
    """

    modality = "C"

    def __init__(self, config: TPVFormerConfig) -> None:
        super().__init__()
        self.config, self.lattice = config, config.lattice
        self.grid_mask = GridMask(config.grid_mask_probability)
        self.backbone = ResNet(config.backbone())
        self.neck = FPN(config.neck())
        self.encoder = TPVEncoder(config.encoder())
        self.aggregator = TPVAggregator(config.aggregator())
        for module in self.backbone.modules():
            if config.backbone_norm_eval and isinstance(module, nn.BatchNorm2d):
                module.requires_grad_(requires_grad=False)

    def forward(self, batch: Batch) -> Tensor:
        rig = CameraRig.of(batch)
        images = padded(self.grid_mask(pictures_of(batch)))
        maps = self.neck(self.backbone(images.flatten(0, 1))[1:])
        features = [level.unflatten(0, images.shape[:2]) for level in maps]
        logits: Tensor = self.aggregator(self.encoder(features, rig, (images.shape[-2], images.shape[-1])))
        return logits

    def losses(self, outputs: Tensor, batch: Batch) -> dict[str, Tensor]:
        if batch.labels is None:
            raise ValueError("losses require labels, but this batch has none")
        with torch.autocast(outputs.device.type, enabled=False):
            weights = outputs.new_tensor(self.config.class_weights)
            return {
                "cross_entropy": cross_entropy(outputs, batch.labels, weights),
                "lovasz": lovasz_softmax(outputs, batch.labels),
            }

    def logits(self, outputs: Tensor, batch: Batch) -> Tensor:
        return outputs


def pictures_of(batch: Batch) -> Tensor:
    """Return the images (B, N, 3, H, W). Raises `ValueError` without cameras."""
    if batch.cameras is None:
        raise ValueError("TPVFormer requires cameras, but this batch has none")
    return batch.cameras.images


def padded(images: Tensor) -> Tensor:
    """Return the images with zeros at the bottom and right, up to multiples of `STRIDE`."""
    height, width = images.shape[-2:]
    return functional.pad(images, (0, -width % STRIDE, 0, -height % STRIDE))
