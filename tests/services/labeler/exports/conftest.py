"""The drive whose labels are exported."""

import pytest

from testing.once import made_once
from tests.services.labeler.exports.made import Labelled, labelled_in, made_labels


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Labelled:
    """Made by the first of the test processes that asks, read by all; nothing in it may be changed."""
    return labelled_in(made_once(tmp_path_factory, "labelled-drive", made_labels))
