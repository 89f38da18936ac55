"""Commands, settings, routes and codes on the pages are generated from the code, or checked against it."""

import re
from pathlib import Path

import pytest

from api.openapi import operations
from docsite.api_pages import document
from docsite.codes_page import raised_codes
from docsite.pages import made_pages
from docsite.readmes import relinked
from docsite.schemas import anchor_of
from services.runtime.settings import Settings
from services.runtime.settings_checks import variables_of
from stone_client.command_tree import leaves

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
SOURCES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "baselines",
    "services", "simulator", "stone_client", "stone_local", "api", "web", "testing", "benchmarks",
    "chaos", "fuzz", "docsite", "deploy", "tests",
)  # fmt: skip
VARIABLE = re.compile(r"\bSTONE_[A-Z0-9_]*[A-Z0-9]\b")


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return dict(made_pages())


@pytest.fixture(scope="module")
def known_variables() -> set[str]:
    """Those of the settings, and whatever a source reads."""
    paths = [path for folder in SOURCES for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".sh")]
    read = {name for path in paths if "node_modules" not in path.parts for name in VARIABLE.findall(path.read_text())}
    return read | set(variables_of(Settings))


def test_every_setting_is_in_the_configuration_reference(made: dict[str, str]) -> None:
    page = made["reference/configuration.md"]
    assert [name for name in variables_of(Settings) if f"`{name}`" not in page] == []
    assert "`STONE_UPLOADS__OWNER_BYTES` | `number` | `1099511627776` (1 TiB)" in page


def test_every_operation_is_in_the_api_reference(made: dict[str, str]) -> None:
    pages = "\n".join(text for name, text in made.items() if name.startswith("reference/api/"))
    said = document()
    listed = [(path, method) for path, method, _ in operations(said)]
    assert len(listed) > 100
    assert [one for one in listed if f"**{one[1].upper()}** `{one[0]}`" not in pages] == []
    assert [name for name in said["components"]["schemas"] if f"{{#{anchor_of(name)}}}" not in pages] == []


def test_every_command_and_code_is_on_its_page(made: dict[str, str]) -> None:
    commands = {words for words, _ in leaves()}
    assert commands >= {"label", "sequence upload", "calibration check", "dataset splits put"}
    assert [words for words in commands if f"### stone {words}\n" not in made["reference/commands.md"]] == []
    assert [one for one in raised_codes() if f"`{one}`" not in made["reference/codes.md"]] == []


def test_pages_name_only_settings_that_exist(known_variables: set[str]) -> None:
    """tests/test_references.py checks the files and modules that pages name."""
    named = {(page.name, name) for page in WRITTEN for name in VARIABLE.findall(page.read_text("utf-8"))}
    assert {one for one in named if not one[1].endswith("__") and not _is_known(one[1], known_variables)} == set()


def test_a_page_from_elsewhere_leads_to_pages_of_the_site_and_keeps_only_the_words_of_what_is_none() -> None:
    said = "[images](../images/README.md), [keys](../../docs/operations/keys.md#now), [chart](stone/Chart.yaml)"
    assert relinked(said, "deploy/kubernetes/README.md", "install/cluster.md") == (
        "[images](images.md), [keys](../operations/keys.md#now), chart"
    )
    assert relinked("[tus](https://tus.io)", "deploy/images/README.md", "install/images.md") == "[tus](https://tus.io)"


def _is_known(name: str, known: set[str]) -> bool:
    """A group alone (`STONE_JOBS`) stands for its settings."""
    return name in known or any(one.startswith(f"{name}__") for one in known)
