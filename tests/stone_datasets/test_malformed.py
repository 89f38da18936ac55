"""Every kind of malformed dataset is refused by its own code, in a sentence that names where it is."""

from pathlib import Path

import pytest

from docsite.codes_page import all_codes
from stone.errors import StoneError
from stone_datasets.faults import DatasetFaultError
from stone_datasets.reading import check_dataset
from tests.stone_datasets.malformed import ANNOTATED, KINDS, Kind


def refused(folder: Path, kind: Kind) -> None:
    code, edit, said = kind
    edit(folder)
    check = check_dataset(folder)
    assert check.contents is None
    assert {fault.code for fault in check.faults.found} == {code}, [str(fault) for fault in check.faults.found]
    assert any(said in str(fault) for fault in check.faults.found), [str(fault) for fault in check.faults.found]


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
        "DST-070",  # test_classes.py
    }
    coded = {one.code for one in all_codes() if one.code.startswith("DST-")}
    assert coded == {code for code, _, _ in (*KINDS.values(), *ANNOTATED.values())} | elsewhere
    assert len(coded) > 45


def test_no_two_faults_share_a_code() -> None:
    leaves = [leaf for leaf in DatasetFaultError.__subclasses__()]
    assert len({leaf.code for leaf in leaves}) == len(leaves)
    assert all(issubclass(leaf, StoneError) and leaf.likely for leaf in leaves)
