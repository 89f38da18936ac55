"""The drive whose labels are exported."""

import pytest

from tests.services.labeler.exports.made import Labelled, made_labels


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Labelled:
    return made_labels(tmp_path_factory.mktemp("drive"))
