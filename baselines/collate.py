"""One batch of several frames: the collate function of loaders."""

from collections.abc import Sequence

import torch

from baselines.batch import Batch, CameraViews, Points


def joined(batches: Sequence[Batch]) -> Batch:
    """One batch of several, in their order."""
    cameras = [batch.cameras for batch in batches if batch.cameras is not None]
    labels = [batch.labels for batch in batches if batch.labels is not None]
    return Batch(
        tokens=tuple(token for batch in batches for token in batch.tokens),
        grid_from_ego=torch.cat([batch.grid_from_ego for batch in batches]),
        cameras=_joined_views(cameras) if cameras else None,
        lidar=_joined_points([batch.lidar for batch in batches if batch.lidar is not None]),
        radar=_joined_points([batch.radar for batch in batches if batch.radar is not None]),
        labels=torch.cat(labels) if labels else None,
    )


def _joined_views(views: Sequence[CameraViews]) -> CameraViews:
    depths = [view.depth_m for view in views if view.depth_m is not None]
    return CameraViews(
        torch.cat([view.images for view in views]),
        torch.cat([view.intrinsics for view in views]),
        torch.cat([view.augmented_from_image for view in views]),
        torch.cat([view.ego_from_camera for view in views]),
        torch.cat(depths) if depths else None,
    )


def _joined_points(points: Sequence[Points]) -> Points | None:
    if not points:
        return None
    frames = [torch.full_like(one.frame, place) for place, one in enumerate(points)]
    return Points(torch.cat([one.features for one in points]), torch.cat(frames))
