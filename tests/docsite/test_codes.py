"""The catalogue of codes holds every code that the sources raise, and nothing else."""

import ast
import re
from pathlib import Path

import pytest

from api import statuses
from docsite.codes_page import CODE_SOURCES, ROOT, raised_codes
from docsite.other_codes import OTHER_CODES
from services.domain.benchmarks.phases import findings as phase_findings
from stone_base.codes.catalogue import CATALOGUE, FAMILIES, PROFILE_CODES, by_family, harm_of, harm_rank
from stone_base.codes.meaning import HARM_ORDER, HARM_SENTENCES, HARM_WORDS
from stone_files.dataset_faults import DATASET_FAULTS
from stone_submissions.errors import MISTAKES

CODE = re.compile(rf"({'|'.join(family for family in FAMILIES if family)})-\d{{3}}")


def strings_of(path: Path) -> set[str]:
    nodes = ast.walk(ast.parse(path.read_text("utf-8")))
    return {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


@pytest.fixture(scope="module")
def strings() -> set[str]:
    """Every string of the sources but the catalogue's own."""
    own = ROOT / "stone_base" / "codes"
    paths = [path for place in CODE_SOURCES for path in sorted((ROOT / place).rglob("*.py")) if own not in path.parents]
    return set().union(*map(strings_of, paths))


def test_every_code_of_a_finding_has_a_meaning_and_every_meaning_is_raised(strings: set[str]) -> None:
    raised = {text for text in strings if CODE.fullmatch(text)}
    assert raised == {code for code in CATALOGUE if code[0].isupper()}
    assert len(raised) >= 150


def test_every_code_of_a_failure_in_the_catalogue_is_raised() -> None:
    told = {text for text in strings_of(Path(phase_findings.__file__)) if text.startswith("labels_")}
    raised = raised_codes() | {"worker_lost"} | told
    assert {code for code in CATALOGUE if not code[0].isupper()} <= raised
    assert told <= set(CATALOGUE)


def test_every_code_that_is_raised_is_in_one_table_and_every_code_of_a_table_is_raised() -> None:
    told = {*statuses.PROBLEM_TYPES, *DATASET_FAULTS, *MISTAKES, *(code for code, _ in OTHER_CODES)}
    assert raised_codes() - set(CATALOGUE) == told - set(CATALOGUE)


def test_every_code_is_in_one_family_and_every_harm_has_its_words() -> None:
    assert sorted(one.code for family in by_family().values() for one in family) == sorted(CATALOGUE)
    assert set(HARM_ORDER) == set(HARM_WORDS) == set(HARM_SENTENCES)
    assert set(CATALOGUE) >= PROFILE_CODES


def test_harm_is_of_the_code_and_of_the_severity() -> None:
    assert (harm_of("TIM-201", "warning"), harm_of("LAB-603", "warning")) == ("none", "wrong")
    assert (harm_of("SYN-506", "info"), harm_of("SYN-506", "warning")) == ("none", "wrong")
    assert (harm_of("BAG-010", "warning"), harm_of("BAG-010", "error")) == ("less", "refused")
    assert (harm_of("SYN-510", "warning"), harm_of("SYN-510", "error")) == ("none", "refused")
    assert harm_of("XYZ-999", "error") is None


def test_most_harm_comes_first_and_an_unknown_code_goes_by_its_severity() -> None:
    given = [
        ("TIM-201", "warning"),
        ("XYZ-999", "error"),
        ("LAB-602", "warning"),
        ("CAL-434", "info"),
        ("LAB-603", "warning"),
    ]
    ordered = sorted(given, key=lambda one: harm_rank(*one))
    assert [code for code, _ in ordered] == ["XYZ-999", "LAB-603", "LAB-602", "TIM-201", "CAL-434"]
