"""What may be chosen from outside is what the labeler has, and within what it takes."""

from dataclasses import asdict

import pytest

from services.domain.sequences.label_choices import BOUNDS, PROFILES, ChoiceError
from services.labeler.parameters import LabelParameters, chosen_parameters, parameters_for


def leaf(record: object, name: str) -> object:
    for part in name.split("."):
        record = record[part]  # type: ignore[index]
    return record


@pytest.mark.parametrize("name", BOUNDS)
@pytest.mark.parametrize("profile", PROFILES)
def test_every_choice_is_a_parameter_whose_default_lies_within_its_bounds(profile: str, name: str) -> None:
    default = leaf(asdict(parameters_for(profile)), name)  # type: ignore[arg-type]
    low, high = BOUNDS[name]
    assert type(default) is type(low) is type(high)
    assert low <= default <= high  # type: ignore[operator]


@pytest.mark.parametrize("name", BOUNDS)
def test_a_choice_changes_that_parameter_and_no_other(name: str) -> None:
    low, _ = BOUNDS[name]
    chosen, plain = asdict(chosen_parameters("local", {name: low})), asdict(parameters_for("local"))
    assert leaf(chosen, name) == low
    if "." in name:
        group, part = name.split(".")
        chosen[group][part] = plain[group][part]
    else:
        chosen[name] = plain[name]
    assert chosen == plain


def test_no_choice_is_the_profile_itself() -> None:
    assert chosen_parameters("paper", {}) == LabelParameters()
    with pytest.raises(ChoiceError, match="the parameters that can be chosen"):
        chosen_parameters("paper", {"tiling.cube_cells": 1})


def test_the_paper_leaves_no_driven_voxel_out() -> None:
    assert chosen_parameters("paper", {"reference.outlier_ratio": 0.0}) == LabelParameters()
    with pytest.raises(ChoiceError, match="profile paper leaves none out"):
        chosen_parameters("paper", {"reference.outlier_ratio": 0.25})
