"""The values that pages show for empty fields are those that the labeler uses."""

from functools import reduce
from typing import Any

import pytest

from services.domain.sequences.label_choices import BOUNDS, DEFAULTS, PROFILES, LabelProfile, default_of
from services.labeler.parameters import parameters_for


@pytest.mark.parametrize("profile", PROFILES)
def test_a_default_is_the_labelers(profile: LabelProfile) -> None:
    assert DEFAULTS.keys() == BOUNDS.keys()
    parameters: Any = parameters_for(profile)
    used = {name: reduce(getattr, name.split("."), parameters) for name in BOUNDS}
    assert {name: default_of(profile, name) for name in BOUNDS} == used
