"""Convergence of the surface's solver over the tiles of a run.

**Conventions.** Residuals are in cells, as `PoissonParameters.tolerance_ratio`; NaN is not converged.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from services.labeler.map.surface import TileSummary
from services.labeler.parameters import SurfaceParameters
from stone.findings import Finding

SLACK_RATIO = 1.001  # the residual that ends the rounds is rounded differently


@dataclass(frozen=True)
class Convergence:
    """The most `rounds` and the worst `residual_ratio` of any tile; `tiles`, and those that stopped above tolerance."""

    rounds: int
    residual_ratio: float
    tiles: int
    unconverged: int

    def as_record(self) -> dict[str, Any]:
        return {
            "most_rounds": self.rounds,
            "worst_residual_ratio": self.residual_ratio if math.isfinite(self.residual_ratio) else None,
            "unconverged_tiles": self.unconverged,
        }


def convergence_of(tiles: Iterable[TileSummary], parameters: SurfaceParameters) -> Convergence | None:
    """Return the convergence, or None if Open3D, which does not report it, made the surface."""
    if parameters.solver == "octree":
        return None
    descents = [tile.descent for tile in tiles]
    residuals = [descent.residual_ratio if math.isfinite(descent.residual_ratio) else math.inf for descent in descents]
    over = sum(residual > SLACK_RATIO * parameters.poisson.tolerance_ratio for residual in residuals)
    return Convergence(
        max((descent.rounds for descent in descents), default=0), max(residuals, default=0.0), len(descents), over
    )


def convergence_findings(convergence: Convergence | None, parameters: SurfaceParameters) -> tuple[Finding, ...]:
    """Return LAB-609 if a tile's surface does not match its points."""
    if convergence is None or not convergence.unconverged:
        return ()
    sentence = (
        f"the surface of {convergence.unconverged} of {convergence.tiles} tiles did not converge in "
        f"{convergence.rounds} rounds (residual up to {convergence.residual_ratio:.2g} cells, tolerance "
        f"{parameters.poisson.tolerance_ratio:g}). Slopes and heights there do not match the points; is the tolerance "
        "too small, or does the map contain points that are not on a surface?"
    )
    return (Finding("LAB-609", "warning", "", sentence),)
