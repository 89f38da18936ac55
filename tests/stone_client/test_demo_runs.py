"""The demo's runs: what they are, that they can be split, and what needs no run at all of its entries."""

from pathlib import Path

from simulator.options import SimulateOptions
from stone.splits.composition import CatalogueEntry
from stone.splits.rules import check_split
from stone.splits.splits import Split
from stone_local.demo.entries import BASELINE, ENTRIES, write_flat_ground
from stone_local.demo.runs import TRAIN, VAL, demo_runs
from stone_submissions.manifest import Manifest, write_manifest
from stone_submissions.validation import validate


def test_the_runs_have_their_conditions_and_no_rule_of_the_splits_is_broken() -> None:
    runs = demo_runs(SimulateOptions())
    catalogue = tuple(
        CatalogueEntry(
            run.name,
            run.name,
            run.conditions["environment"],
            run.conditions["illumination"],
            run.conditions["region"],
            run.simulation.seconds,
            frames=1,
        )
        for run in runs
    )
    parts = {part: tuple(run.name for run in runs if run.part == part) for part in (TRAIN, VAL)}
    assert {part: len(names) for part, names in parts.items()} == {TRAIN: 1, VAL: 2}
    assert all(all(run.conditions.values()) for run in runs)
    assert [one for one in check_split(Split(**parts), catalogue) if one.severity == "error"] == []


def test_the_validated_runs_are_driven_far_enough_for_intervals() -> None:
    driven_m = sum(run.simulation.seconds * run.simulation.speed_m_s for run in demo_runs(SimulateOptions())[1:])
    assert driven_m >= 480


def test_a_run_that_is_too_short_for_a_split_stays_alone() -> None:
    assert [run.name for run in demo_runs(SimulateOptions(seconds=2.0))] == ["demo"]


def test_flat_ground_is_a_valid_submission(tmp_path: Path) -> None:
    tokens = tuple(f"{number:032x}" for number in range(3))
    write_manifest(tmp_path / "manifest.json", Manifest({"demo-dusk": tokens}))
    write_flat_ground(tmp_path / "manifest.json", tmp_path / "flat.zip")
    assert validate(tmp_path / "flat.zip", tmp_path / "manifest.json").ok


def test_one_entry_is_ranked_and_the_others_are_baselines() -> None:
    assert [entry.kind for entry in ENTRIES] == ["baseline", "baseline", "entry"]
    assert BASELINE in ENTRIES
