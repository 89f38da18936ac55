"""Clients that others generate from the document: openapi-python-client and openapi-typescript, against the API."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from services.runtime.platform import Platform
from testing.api.serving import Person, person, serving

ROOT = Path(__file__).resolve().parents[2]
CLIENTS = ROOT / "tests" / "clients"
PYTHON = ROOT / "build" / "openapi-python-client" / "bin"
INSTALL = "deploy/install-test-clients.sh"

pytestmark = pytest.mark.whole


@pytest.fixture
def served(platform: Platform, tmp_path: Path) -> Iterator[tuple[str, Person]]:
    """The URL of an API and a curator; its document is `openapi.json`."""
    from api.main import make_api

    application = make_api(platform)
    (tmp_path / "openapi.json").write_text(json.dumps(application.openapi()))
    with serving(platform, application) as url:
        yield url, person(platform, "curator")


def ran(*command: object, folder: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def assert_used(said: str, caller: Person, name: str) -> None:
    found: dict[str, Any] = json.loads(said)
    assert found == {"caller": caller.name, "made": name, "names": [name], "refused": "not_found"}


def test_a_python_client_is_generated_whole_and_works(served: tuple[str, Person], tmp_path: Path) -> None:
    if not (PYTHON / "openapi-python-client").exists():
        pytest.skip(f"openapi-python-client is not installed: run {INSTALL}")
    settings = ROOT / "examples" / "openapi-python-client.yaml"
    where = ("--path", "openapi.json", "--output-path", "client", "--config", settings)
    assert "WARNING" not in ran(PYTHON / "openapi-python-client", "generate", *where, folder=tmp_path)
    url, caller = served
    use = CLIENTS / "generated" / "use.py"
    assert_used(ran(PYTHON / "python", use, "client", url, caller.secret, folder=tmp_path), caller, "by-python")


def test_types_for_typescript_are_generated_and_strict(served: tuple[str, Person], tmp_path: Path) -> None:
    node, modules = shutil.which("node"), CLIENTS / "node_modules"
    if node is None or not (modules / "openapi-typescript").is_dir():
        pytest.skip(f"node or openapi-typescript is not installed: run {INSTALL}")
    (tmp_path / "node_modules").symlink_to(modules)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    shutil.copy(CLIENTS / "generated" / "use.ts", tmp_path)
    generator = (modules / "openapi-typescript/bin/cli.js", "--default-non-nullable=false", "openapi.json")
    ran(node, *generator, "-o", "schema.d.ts", folder=tmp_path)
    options = ("--strict", "--target", "es2022", "--module", "nodenext", "--lib", "es2022,dom,dom.iterable")
    ran(node, modules / "typescript/bin/tsc", *options, "use.ts", folder=tmp_path)
    url, caller = served
    assert_used(ran(node, "use.js", url, caller.secret, folder=tmp_path), caller, "by-typescript")
