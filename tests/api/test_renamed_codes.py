"""A code that was renamed is found by its old name, and raised by nobody."""

import httpx
import pytest
from typer.testing import CliRunner

from api.statuses import PROBLEM_TYPES
from docsite.codes_page import raised_codes
from stone_base.codes.catalogue import CATALOGUE
from stone_base.codes.renamed import RENAMED
from stone_client.main import app


def test_only_new_codes_are_raised() -> None:
    raised = raised_codes()
    assert set(RENAMED.values()) <= raised
    assert not set(RENAMED) & (raised | set(CATALOGUE) | set(PROBLEM_TYPES))


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_explain_accepts_the_old_name_and_names_the_new_one(old: str, new: str) -> None:
    outcome = CliRunner().invoke(app, ["explain", old])
    assert outcome.exit_code == 0
    assert outcome.output.startswith(f"{old} is the earlier name of {new}")


def test_the_old_address_of_a_problem_leads_to_the_new_code(api: httpx.Client) -> None:
    assert api.get("/api/v1/problems/shut_out").json()["code"] == "account_deactivated"
