"""The images' recipes: sound by hadolint, run by nobody in particular, probed, sent neither data nor secrets."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
DEPLOY = ROOT / "deploy"
RECIPES = sorted([*(DEPLOY / "images").glob("*.Dockerfile"), *(DEPLOY / "stand-in").glob("*.Dockerfile")])


def test_hadolint_finds_nothing() -> None:
    hadolint = Path(sys.executable).parent / "hadolint"
    assert len(RECIPES) == 9
    outcome = subprocess.run([hadolint, "--no-color", *RECIPES], check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stdout) == (0, ""), outcome.stdout


@pytest.mark.parametrize("role", ["api", "ingest", "labeler", "eval"])
def test_an_image_runs_its_role_as_nobody_and_is_probed(role: str) -> None:
    stage = (DEPLOY / "images" / f"{role}.Dockerfile").read_text("utf-8").rpartition("\nFROM ")[2]
    assert re.findall(r"(?m)^USER (\S+)", stage)[-1] == "10001:10001"
    assert stage.rindex("USER 10001:10001") < stage.index("\nCMD "), "nothing runs as root after"
    module = "services.runtime.processes." + ("api" if role == "api" else f'worker", "{role}')
    assert f'CMD ["python", "-m", "{module}"]' in stage
    probe = re.search(r"HEALTHCHECK (.*) CMD (\[.*\])", stage)
    assert probe is not None
    assert ("/readyz" if role == "api" else "services.runtime.processes.health_check") in probe[2]
    assert "COPY --from=packages /sbom.json /sbom.json" in stage


def test_a_build_is_sent_neither_data_nor_secrets() -> None:
    rules = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    rules = [rule for rule in rules if rule and not rule.startswith("#")]
    assert rules[0] == "*", "what is not named is not sent"
    sent = {rule.removeprefix("!") for rule in rules if rule.startswith("!")}
    assert not {"deploy", "deploy/compose", ".git", "stone-data", "build"} & sent


def test_every_script_is_one_and_those_that_are_called_may_be() -> None:
    scripts = sorted(DEPLOY.rglob("*.sh"))
    outcome = [subprocess.run(["sh", "-n", script], check=False, capture_output=True).stderr for script in scripts]
    assert outcome == [b""] * len(scripts)
    assert [script.name for script in scripts if script.parent == DEPLOY and not os.access(script, os.X_OK)] == []
