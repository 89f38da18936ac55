"""A guide's lines as a reader pastes them: in their order, in one folder, in one shell.

**Conventions.** Blocks without a language are typed; blocks with one are saved under the name that their first line's
comment says. A plain `stone …` or `python FILE`, with or without `.venv/bin/`, runs in this process, so that no line
takes seconds to start, unless another environment is tested; the rest is one bash, whose variables and functions last.
A line that fails ends the test, and so does an answer of HTTP that is a refusal.
"""

import os
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from stone_client.main import app

DOCS = Path(__file__).resolve().parents[2] / "docs"
ADDRESS = "http://127.0.0.1:8080"
PASSWORD = "correct horse battery staple"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
HEREDOC = re.compile(r"<<'(\w+)'$")
OF_A_SHELL = re.compile(r"[|&<>$;({]")
MARK = "--- the line is over"
PRELUDE = 'set -o pipefail; curl() { command curl --fail-with-body -sS "$@"; }'


def blocks(page: str) -> Iterator[tuple[str, str]]:
    """Language and text of every block of the guide."""
    yield from BLOCK.findall((DOCS / page).read_text("utf-8"))


def statements(block: str) -> Iterator[str]:
    """The lines of a block; a here-document is one with its text."""
    lines = iter(block.strip("\n").splitlines())
    for line in lines:
        opened = HEREDOC.search(line)
        text = [line]
        while opened and text[-1] != opened.group(1):
            text.append(next(lines))
        yield "\n".join(text)


@dataclass
class Shell:
    """The shell that a guide is pasted into. `said` is what the page says and a test has elsewhere: an address, a size;
    `answers` is what is typed at every prompt."""

    said: Mapping[str, str]
    bash: subprocess.Popen[str]
    is_here: bool = True
    printed: list[str] = field(default_factory=list)
    answers: str = f"{PASSWORD}\n"

    def paste(self, page: str, elsewhere: Collection[str] = ()) -> int:
        """Paste the whole guide but for what is tested elsewhere; how many lines that were."""
        typed = 0
        for kind, block in blocks(page):
            if kind:
                Path(block.split()[1].rstrip(":")).write_text(self.here(block))
                continue
            for line in statements(block):
                if line not in elsewhere:
                    self.type(line)
                    typed += 1
        return typed

    def type(self, line: str) -> None:
        line = self.here(line)
        is_plain = not OF_A_SHELL.search(re.split(r"\s#", line)[0])
        words = shlex.split(line, comments=True) if is_plain else [""]
        program = words[0].removeprefix(".venv/bin/")
        if not self.is_here:
            self.printed.append(self._typed_in_bash(line))
        elif program == "stone":
            result = CliRunner().invoke(app, words[1:], input=self.answers)
            assert result.exit_code == 0, (line, result.stdout, result.stderr, result.exception)
            self.printed.append(result.stdout)
        elif program == "python":
            before, sys.argv = sys.argv, words[1:]
            runpy.run_path(words[1])
            sys.argv = before
        else:
            self.printed.append(self._typed_in_bash(line))

    def here(self, text: str) -> str:
        """Return the text with what a test has elsewhere in the place of what the page says."""
        for there, here in self.said.items():
            text = text.replace(there, here)
        return text

    def _typed_in_bash(self, line: str) -> str:
        assert self.bash.stdin is not None
        assert self.bash.stdout is not None
        self.bash.stdin.write(f"{{ {line}\n}} </dev/null; printf '\\n%s %d\\n' '{MARK}' $?\n")
        self.bash.stdin.flush()
        said: list[str] = []
        for answer in self.bash.stdout:
            if answer.startswith(MARK):
                assert answer == f"{MARK} 0\n", (line, "".join(said))
                return "".join(said)
            said.append(answer)
        raise AssertionError((line, "the shell ended", "".join(said)))


@contextmanager
def shell_in(
    folder: Path, said: Mapping[str, str], patch: pytest.MonkeyPatch, *, is_here: bool = True
) -> Iterator[Shell]:
    """A shell whose home and place is `folder`, with this installation's `.venv` in it if `is_here`, else none."""
    for name in [name for name in os.environ if name.startswith(("STONE_", "XDG_CONFIG", "PYTHONPATH"))]:
        patch.delenv(name)
    patch.setenv("HOME", str(folder))
    patch.chdir(folder)
    if is_here:
        (folder / ".venv").symlink_to(Path(sys.executable).parents[1])
    command = ["bash", "--noprofile", "--norc"]
    streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, text=True, **streams) as bash:
        shell = Shell(said, bash, is_here)
        shell.type(PRELUDE)
        try:
            yield shell
        finally:
            bash.kill()
