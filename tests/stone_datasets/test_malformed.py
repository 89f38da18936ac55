"""Every kind of malformed dataset is refused by its own code, in a sentence that names where it is."""

from pathlib import Path

import pytest

from stone.errors import StoneError
from stone_datasets.faults import DatasetFaultError
from stone_datasets.reading import check_dataset
from tests.stone_datasets.malformed import ANNOTATED, KINDS, Kind


def refused(folder: Path, kind: Kind) -> None:
    code, edit, said = kind
    edit(folder)
    check = check_dataset(folder)
    assert check.contents is None
    told = [str(fault) for fault in check.faults.found]
    assert {fault.code for fault in check.faults.found} == {code}, told
    assert any(said in one for one in told), told


@pytest.mark.parametrize("name", KINDS)
def test_a_malformed_release_is_refused_by_its_code(copied: Path, name: str) -> None:
    refused(copied, KINDS[name])


@pytest.mark.parametrize("name", ANNOTATED)
def test_malformed_annotations_are_refused_by_their_code(copied_annotated: Path, name: str) -> None:
    refused(copied_annotated, ANNOTATED[name])


def test_every_code_of_datasets_has_a_kind_that_provokes_it() -> None:
    elsewhere = {
        "DST-003",  # test_files.py
        "DST-005",  # test_json_stream.py
        "DST-048",  # test_scene_tables.py
        "DST-049",  # what only an import refuses: tests/services/labeler/imports
        "DST-071",
        "DST-072",
        "DST-070",  # test_classes.py
    }
    coded = {leaf.code for leaf in DatasetFaultError.__subclasses__()}
    assert coded == {code for code, _, _ in (*KINDS.values(), *ANNOTATED.values())} | elsewhere
    assert len(coded) > 45


def test_no_two_faults_share_a_code() -> None:
    leaves = DatasetFaultError.__subclasses__()
    assert len({leaf.code for leaf in leaves}) == len(leaves)
    assert all(issubclass(leaf, StoneError) and leaf.likely for leaf in leaves)
