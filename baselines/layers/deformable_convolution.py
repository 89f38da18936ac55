"""Deformable convolution, 3 × 3: each tap reads at its place plus an offset that a plain convolution predicts.

out(p) = Σ_k w_k · m_k(p) · x(stride·p + k + Δ_k(p)), x bilinear between pixels and 0 beyond the edge.

**Conventions.** Taps run over rows, then columns; `conv_offset` returns (Δv, Δu) of each of the nine, then the nine
logits of m = sigmoid. This is the order of mmcv, so that its checkpoints fit. Initial offsets are 0, so m is ½. Source:
Zhu et al., Deformable ConvNets v2 (CVPR 2019); Dai et al. (ICCV 2017) if `is_modulated` is false (m = 1);
mmcv/ops/modulated_deform_conv.py.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

TAPS = 9


def sampled_taps(images: Tensor, offsets: Tensor, stride: int) -> Tensor:
    """Return values (N, C, 9, H', W') of images (N, C, H, W) at the taps moved by `offsets` (N, 9, 2, H', W'), v before
    u.

    Computed in at least float32, because half precision of an offset is a pixel of a wide image.
    """
    dtype = torch.promote_types(images.dtype, torch.float32)
    places = offsets.to(dtype) + tap_places(offsets, stride).to(dtype)
    size = places.new_tensor(images.shape[2:])[None, None, :, None, None]
    normalised = ((2 * places + 1) / size - 1).flip(2).permute(0, 1, 3, 4, 2)
    count, _, height, width, _ = normalised.shape
    grid = normalised.reshape(count, TAPS * height, width, 2)
    values = functional.grid_sample(images.to(dtype), grid, padding_mode="zeros", align_corners=False)
    return values.reshape(count, images.shape[1], TAPS, height, width)


def tap_places(offsets: Tensor, stride: int) -> Tensor:
    """Return the pixels (9, 2, H', W') of the taps of an undeformed convolution with padding 1, v before u."""
    height, width = offsets.shape[3:]
    step = torch.arange(-1, 2, device=offsets.device)
    taps = torch.stack(torch.meshgrid(step, step, indexing="ij")).reshape(2, TAPS).T
    rows, columns = (torch.arange(n, device=offsets.device) * stride for n in (height, width))
    centres = torch.stack(torch.meshgrid(rows, columns, indexing="ij"))
    return taps[:, :, None, None] + centres


class DeformableConv2d(nn.Module):
    """Images (N, C, H, W) to (N, C', ⌈H / stride⌉, ⌈W / stride⌉); without bias, because a normalisation follows."""

    def __init__(
        self, channels_in: int, channels_out: int, *, stride: int = 1, groups: int = 1, is_modulated: bool = True
    ) -> None:
        super().__init__()
        self.stride, self.groups, self.is_modulated = stride, groups, is_modulated
        self.weight = nn.Parameter(torch.empty(channels_out, channels_in // groups, 3, 3))
        self.conv_offset = nn.Conv2d(channels_in, (3 if is_modulated else 2) * TAPS, 3, stride, padding=1)
        nn.init.kaiming_uniform_(self.weight, nonlinearity="relu")
        nn.init.zeros_(self.conv_offset.weight)
        nn.init.zeros_(self.conv_offset.bias)  # type: ignore[arg-type]  # this one has a bias

    def forward(self, images: Tensor) -> Tensor:
        predicted = self.conv_offset(images)
        with torch.autocast(images.device.type, enabled=False):
            offsets = predicted[:, : 2 * TAPS].unflatten(1, (TAPS, 2))
            values = sampled_taps(images, offsets, self.stride)
            if self.is_modulated:
                values = values * predicted[:, None, 2 * TAPS :].to(values.dtype).sigmoid()
        weight = self.weight.reshape(len(self.weight), -1, 1, 1)
        return functional.conv2d(values.flatten(1, 2), weight, groups=self.groups)
