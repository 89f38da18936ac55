"""The client's distribution: of the platform's release, of its own packages, and with few requirements."""

import re
import tomllib
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from api.client_wheel import FILENAME, ClientWheel, install_line

ROOT = Path(__file__).resolve().parents[3]


def project(folder: Path) -> dict[str, Any]:
    return tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))


def vendored() -> tuple[str, ...]:
    """What the hook of the client's build says, without hatchling, which is not installed here."""
    text = (ROOT / "deploy" / "client" / "packages_hook.py").read_text("utf-8")
    line = next(line for line in text.splitlines() if line.startswith("VENDORED = "))
    found: tuple[str, ...] = eval(line.removeprefix("VENDORED = "))
    return found


def test_client_and_platform_are_of_one_release_and_the_platform_asks_for_that() -> None:
    ours, client = project(ROOT)["project"], project(ROOT / "deploy" / "client")["project"]
    assert client["version"] == ours["version"]
    assert f"stone-client=={ours['version']}" in ours["dependencies"]


def test_the_platforms_wheel_holds_every_package_but_the_client_and_both_pages_name_them() -> None:
    of_platform = project(ROOT)["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    roots: list[str] = project(ROOT)["tool"]["importlinter"]["root_packages"]
    assert sorted([*of_platform, "stone_client"]) == sorted(roots)
    assert set(vendored()) < set(of_platform), "where both are installed, the platform's are imported"
    for page in ("README.md", "docs/administrator.md"):
        (sentence,) = re.findall(r"installs these: (.+?)\.", read(page), re.DOTALL)
        assert re.findall(r"`(\w+)`", sentence) == of_platform, page


def read(page: str) -> str:
    return (ROOT / page).read_text("utf-8")


def test_the_participants_guide_begins_with_the_line_that_the_page_shows() -> None:
    line = install_line("http://127.0.0.1:8080", ClientWheel(FILENAME, b""))
    first = (ROOT / "docs" / "participant.md").read_text("utf-8").split("```")[1]
    assert first.strip().endswith(f".venv/bin/{line}")


def test_versions_that_the_client_takes_are_those_of_the_platform() -> None:
    ours = {Requirement(line).name: line for line in project(ROOT)["project"]["dependencies"]}
    for line in project(ROOT / "deploy" / "client")["project"]["dependencies"]:
        assert ours[Requirement(line).name] == line
