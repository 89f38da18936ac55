"""Wrong usages, each with its exit code and its sentence: `wrong_usages.tsv`, which WRITES_GOLDEN=1 writes anew.

**Conventions.** The lines run in this process, in a folder with a few files that no command can use, without a server.
The exit code is 2 for wrong usage, 1 for a refused input; nothing is ever written, and there is no traceback.
"""

import os
import re
import shlex
from pathlib import Path

import pytest

from tests.stone_client.participating import stone

TABLE = Path(__file__).with_name("wrong_usages.tsv")
HEAD = "command\texit code\tsentence"
ROWS = [tuple(line.split("\t")) for line in TABLE.read_text("utf-8").splitlines()[1:]]
USELESS = {
    "run.mcap": "no recording", "cal.yaml": "no: calibration\n", "page.zip": "<html>", "poses.txt": "no poses",
    "m.json": '{"stone_manifest": 1, "sequences": {"a": ["00000000000000000000000000000000"]}}',
}  # fmt: skip
BOX = re.compile(r"^│ (.*?) *│$", re.MULTILINE)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the commands, on a terminal as wide as any sentence."""
    folder = tmp_path / "here"
    (folder / "folder").mkdir(parents=True)
    for name, content in USELESS.items():
        (folder / name).write_text(content)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "600")
    return folder


def ended(line: str) -> tuple[int, str]:
    """The exit code of a line, and the sentence that says why."""
    result = stone(*shlex.split(line)[1:])
    assert result.exception is None or isinstance(result.exception, SystemExit), (line, result.exception)
    boxed = " ".join(BOX.findall(result.stderr)).split()
    sentences = [said for said in result.stderr.splitlines() if " is now " not in said]
    sentence = " ".join(boxed) if boxed else sentences[0] if sentences else "(help)"
    return result.exit_code, sentence.replace(str(Path.cwd()), ".")


def test_the_table_of_wrong_usages(folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    found = [(row[0], *map(str, ended(row[0]))) for row in ROWS]
    assert sorted(folder.rglob("*")) == before
    if os.environ.get("WRITES_GOLDEN"):
        TABLE.write_text("\n".join([HEAD, *map("\t".join, found), ""]), "utf-8")
        pytest.skip("the table was written anew")
    assert found == ROWS


def test_the_table_is_long_and_its_sentences_are_none_of_a_library() -> None:
    assert len(ROWS) >= 100
    assert {code for _, code, _ in ROWS} == {"1", "2"}
    for line, _, sentence in ROWS:
        assert not re.search(r"Value error|Input should be|Traceback|pydantic|NoneType", sentence), line
