"""How the surface was solved for stands in the report, and where it was not a finding says so."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.convergence import convergence_findings, convergence_of
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import LabelParameters, SurfaceParameters, parameters_for
from services.labeler.run import Tile
from stone.labels.traversability import FeatureSums
from stone.sensors.calibration import Box
from stone.surface.screened_poisson import MOST_ROUNDS, Descent, PoissonParameters
from tests.services.labeler.worlds import RayCast, World, sequence_of

WORLD = World(grade=(0.04, -0.02), boxes=(Box((1.0, 1.5, 0.0), (2.0, 2.5, 0.8)),), frames=4, reach_m=4.0)
SURFACE = SurfaceParameters()


def labelled(folder: Path, parameters: LabelParameters) -> dict[str, object]:
    label(sequence_of(WORLD), RayCast(WORLD), folder, LabelOptions(parameters))
    record: dict[str, object] = json.loads((folder / "report.json").read_text("utf-8"))
    return record


def tile(rounds: int, residual_ratio: float) -> TileSummary:
    sums = FeatureSums(np.zeros(3), 0, np.zeros(3), np.zeros((3, 3)))
    return TileSummary(Tile(0, 0), np.zeros((0, 3)), sums, sums, 0, 0, 0, 0, 0, Descent(rounds, residual_ratio))


def test_a_surface_that_is_solved_is_told_and_nothing_found(tmp_path: Path) -> None:
    record = labelled(tmp_path / "out", parameters_for("local"))
    solver = record["solver"]
    assert isinstance(solver, dict)
    assert 0 < solver["most_rounds"] < 200
    assert 0 < solver["worst_residual_ratio"] <= SURFACE.poisson.tolerance_ratio
    assert solver["unconverged_tiles"] == 0
    assert "LAB-609" not in str(record["findings"])


def test_a_surface_that_cannot_be_solved_for_in_the_rounds_is_found(tmp_path: Path) -> None:
    whole = parameters_for("local")
    endless = replace(SURFACE, poisson=PoissonParameters(tolerance_ratio=1e-300))
    record = labelled(tmp_path / "out", replace(whole, surface=endless))
    solver, findings = record["solver"], record["findings"]
    assert isinstance(solver, dict)
    assert isinstance(findings, list)
    assert 200 < solver["most_rounds"] <= MOST_ROUNDS
    assert solver["unconverged_tiles"] == 1
    (found,) = [finding for finding in findings if finding["code"] == "LAB-609"]
    assert found["severity"] == "warning"
    assert f"1 of 1 tiles was left unsolved after {solver['most_rounds']} rounds" in found["message"]


@pytest.mark.parametrize("residual", [np.nan, np.inf])
def test_a_residual_that_is_no_number_is_not_converged(residual: float) -> None:
    found = convergence_of([tile(5, 1e-6), tile(2000, residual)], SURFACE)
    assert found is not None
    assert (found.unconverged, found.tiles) == (1, 2)
    assert found.as_record() == {"most_rounds": 2000, "worst_residual_ratio": None, "unconverged_tiles": 1}
    assert [finding.code for finding in convergence_findings(found, SURFACE)] == ["LAB-609"]


def test_of_open3d_nothing_is_said() -> None:
    octree = replace(SURFACE, solver="octree")
    assert convergence_of([tile(0, 0.0)], octree) is None
    assert convergence_findings(None, octree) == ()
