"""Augmentation of a frame for training, as in OpenOccupancy's configurations: images and the grid.

**Conventions.** Random draws depend on the seed, the epoch and the frame alone, so that a resumed run draws the same.
Pixels: `augmented_from_image` is affine with the centre of the first pixel at (0, 0). The grid is mirrored along x and
y, about the robot: exactly a permutation of voxels, since it is symmetric. Source: BEVDet (Huang et al., 2021), 3.2;
OpenOccupancy, `data_config` and `bda_aug_conf`.
"""

import math
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Matrix = NDArray[np.float64]
IMAGENET_MEAN, IMAGENET_DEVIATION = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


@dataclass(frozen=True)
class AugmentConfig:
    """Ranges of the draws: zoom about 1, rotation of images, and probabilities of mirroring."""

    zoom_below: float = 0.06
    zoom_above: float = 0.11
    rotation_deg: float = 5.4
    mirror_picture_ratio: float = 0.5
    mirror_x_ratio: float = 0.5
    mirror_y_ratio: float = 0.5


NO_AUGMENTATION = AugmentConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class GridMirrors:
    """The mirrored axes of the grid."""

    x: bool = False
    y: bool = False

    def grid_from_ego(self) -> Matrix:
        """Return the reflection (4, 4)."""
        return np.diag([-1.0 if self.x else 1.0, -1.0 if self.y else 1.0, 1.0, 1.0])

    def of_labels(self, labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return labels (X, Y, Z) in the grid frame."""
        return labels[:: -1 if self.x else 1, :: -1 if self.y else 1]


def generator_of(seed: int, epoch: int, index: int) -> np.random.Generator:
    """Return the generator of a frame's augmentation."""
    return np.random.default_rng((seed, epoch, index))


def draw_mirrors(config: AugmentConfig, rng: np.random.Generator) -> GridMirrors:
    """Draw the mirrored axes of the grid."""
    draws = rng.random(2)
    return GridMirrors(bool(draws[0] < config.mirror_x_ratio), bool(draws[1] < config.mirror_y_ratio))


def draw_picture_change(config: AugmentConfig, size_px: tuple[int, int], rng: np.random.Generator) -> Matrix:
    """Return `augmented_from_image` (3, 3) for images of `size_px` (height, width): zoomed, cropped, mirrored, rotated.

    A zoomed-in image is cropped at a random column and at its top, like in the official code; a zoomed-out image lies
    at the bottom with black around it.
    """
    height, width = size_px
    zoom = 1 + rng.uniform(-config.zoom_below, config.zoom_above)
    spare_x, spare_y = (zoom - 1) * width, (zoom - 1) * height
    across = rng.uniform(0, 1) * spare_x if spare_x > 0 else spare_x / 2
    zoomed = np.array([[zoom, 0, (zoom - 1) / 2 - across], [0, zoom, (zoom - 1) / 2 - spare_y], [0, 0, 1]])
    if rng.uniform() < config.mirror_picture_ratio:
        zoomed = np.array([[-1.0, 0, width - 1], [0, 1, 0], [0, 0, 1]]) @ zoomed
    changed: Matrix = _turned(math.radians(rng.uniform(-1, 1) * config.rotation_deg), size_px) @ zoomed
    return changed


def _turned(angle_rad: float, size_px: tuple[int, int]) -> Matrix:
    """Return a rotation about the middle of the image."""
    cx, cy = (size_px[1] - 1) / 2, (size_px[0] - 1) / 2
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, cx - c * cx + s * cy], [s, c, cy - s * cx - c * cy], [0, 0, 1]])


def changed_picture(jpeg: bytes, augmented_from_image: Matrix) -> NDArray[np.float32]:
    """Return the normalised image (3, H, W) float32 under the change, bilinear, black outside."""
    with Image.open(BytesIO(jpeg), formats=("JPEG",)) as image:
        picture = image.convert("RGB")
    if not np.array_equal(augmented_from_image, np.eye(3)):
        (a, b, u), (c, d, v) = np.linalg.inv(augmented_from_image)[:2]
        # Pillow's pixel centres are at one half.
        coefficients = (a, b, u + 0.5 - (a + b) / 2, c, d, v + 0.5 - (c + d) / 2)
        picture = picture.transform(picture.size, Image.Transform.AFFINE, coefficients, Image.Resampling.BILINEAR)
    pixels = np.asarray(picture, np.float32)
    normal = (pixels - np.array(IMAGENET_MEAN, np.float32)) / np.array(IMAGENET_DEVIATION, np.float32)
    return np.ascontiguousarray(normal.transpose(2, 0, 1))
