"""Scores of a submission by the platform's kernels; `stone_client/scoring.py` computes them without the platform."""

from pathlib import Path

from services.eval import pipeline
from stone.scoring.score_record import Scores
from stone_base.label_grid import LabelGrid
from stone_client.progress import Report
from stone_local.frame_order import in_time_order
from stone_submissions.ground_truth import Mask


def score(
    submission: Path,
    ground_truth: Path,
    *,
    mask: Mask = "all",
    least_confidence: float = 0.0,
    grid: LabelGrid | None = None,
    progress: Report,
) -> Scores:
    """Return the scores of a submission against a folder of labels. Raises as `services.eval.pipeline.score` does."""
    return pipeline.score(
        submission,
        ground_truth,
        mask=mask,
        least_confidence=least_confidence,
        progress=progress,
        order=in_time_order,
        grid=grid,
    )
