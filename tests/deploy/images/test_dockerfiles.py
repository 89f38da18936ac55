"""The images' recipes: sound by hadolint, run by nobody in particular, probed, stopped in order."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DEPLOY = ROOT / "deploy"
RECIPES = sorted([*(DEPLOY / "images").glob("*.Dockerfile"), *(DEPLOY / "stand-in").glob("*.Dockerfile")])
ROLES = ("api", "ingest", "labeler", "eval")
SCRIPTS = sorted(path for folder in ("images", "compose", "stand-in") for path in (DEPLOY / folder).glob("*.sh"))


def last_stage(role: str) -> str:
    return (DEPLOY / "images" / f"{role}.Dockerfile").read_text("utf-8").rpartition("\nFROM ")[2]


def test_hadolint_finds_nothing() -> None:
    hadolint = Path(sys.executable).parent / "hadolint"
    assert len(RECIPES) == 9
    outcome = subprocess.run([hadolint, "--no-color", *RECIPES], check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stdout) == (0, ""), outcome.stdout


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_script_is_one(script: Path) -> None:
    outcome = subprocess.run(["sh", "-n", script], check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stderr) == (0, "")


@pytest.mark.parametrize("role", ROLES)
def test_an_image_is_run_by_a_user_without_a_name_on_the_host(role: str) -> None:
    stage = last_stage(role)
    assert re.findall(r"(?m)^USER (\S+)", stage)[-1] == "10001:10001"
    assert stage.rindex("USER 10001:10001") < stage.index("\nCMD "), "nothing runs as root after"


@pytest.mark.parametrize("role", ROLES)
def test_an_image_says_how_it_is_probed_and_what_it_runs(role: str) -> None:
    stage = last_stage(role)
    module = "services.runtime.processes." + ("api" if role == "api" else f'worker", "{role}')
    assert f'CMD ["python", "-m", "{module}"]' in stage
    probe = re.search(r"HEALTHCHECK (.*) CMD (\[.*\])", stage)
    assert probe is not None
    assert ("/readyz" if role == "api" else "services.runtime.processes.health_check") in probe[2]


@pytest.mark.parametrize("role", ROLES)
def test_an_image_tells_its_version_and_carries_its_bill_of_materials(role: str) -> None:
    stage = last_stage(role)
    assert f'org.opencontainers.image.title="stone-{role}"' in stage
    assert "COPY --from=packages /sbom.json /sbom.json" in stage


def test_no_recipe_takes_what_is_newest_today() -> None:
    for recipe in RECIPES:
        assert ":latest" not in recipe.read_text("utf-8")
    base = (DEPLOY / "images" / "base.Dockerfile").read_text("utf-8")
    assert re.search(r"PYTHON_IMAGE=python:3\.11\.\d+-slim-\w+\n", base)


def test_a_build_is_sent_neither_data_nor_secrets() -> None:
    rules = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    rules = [rule for rule in rules if rule and not rule.startswith("#")]
    assert rules[0] == "*", "what is not named is not sent"
    sent = {rule.removeprefix("!") for rule in rules if rule.startswith("!")}
    assert not {"deploy", "deploy/compose", ".git", "stone-data", "build"} & sent
