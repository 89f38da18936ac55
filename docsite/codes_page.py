"""The reference of all error and finding codes, with the status each is answered with.

**Conventions.** Read off the sources without running them: a class with a `code`, and its docstring's first line.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

from api.statuses import OF_OTHERS, STATUS_OF, status_of
from docsite.markdown import code, plain, table
from stone.errors import StoneError

ROOT = Path(__file__).resolve().parents[1]
CODE_SOURCES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "baselines",
    "services", "simulator", "stone_client", "stone_local", "api", "web",
)  # fmt: skip
HEAD = """# Codes

Whatever is refused, or found wrong, has a code that does not change, and one sentence with the value, the limit and
the likely mistake. Over HTTP it is `application/problem+json` with `code`, `detail`, `request_id` and `errors`; on the
command line `code: sentence` on stderr and exit code 1; of a job its failure. The sentence is for people, the code for
programs.
"""


@dataclass(frozen=True)
class Code:
    """A class of refusals: its code, what it means, where it stands."""

    code: str
    name: str
    meaning: str
    place: str


def codes_page() -> str:
    """The page."""
    statuses = {leaf.__name__: status_of(leaf) for base in STATUS_OF for leaf in _leaves(base)}
    found = sorted(all_codes(), key=lambda one: (one.code, one.name))
    answered = [one for one in found if one.name in statuses]
    others = [one for one in found if one.name not in statuses]
    inputs = [one for one in others if one.code[:1].isupper()]
    rest = [one for one in others if not one.code[:1].isupper()]
    rows = sorted((str(statuses[one.name]), code(one.code), plain(one.meaning)) for one in answered)
    return "\n".join(
        [
            HEAD,
            "## Answers of the API\n",
            table(("status", "code", ""), ((_phrase(status), *said) for status, *said in rows)),
            "## Recordings, calibrations, labels\n",
            "These are the codes of refusals; findings that only warn bear codes of the same families.\n",
            table(("code", ""), ((code(one.code), plain(one.meaning)) for one in inputs)),
            "## Submissions, jobs, commands\n",
            table(("code", ""), ((code(one.code), plain(one.meaning)) for one in rest)),
        ]
    )


def all_codes() -> Iterator[Code]:
    """Every class with a code of its own, wherever it stands."""
    for place in CODE_SOURCES:
        for path in sorted((ROOT / place).rglob("*.py")):
            yield from _codes_of(path)


def _codes_of(path: Path) -> Iterator[Code]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.ClassDef):
            continue
        for said in node.body:
            if _is_code(said):
                value = said.value.value  # type: ignore[attr-defined]
                meaning = (ast.get_docstring(node) or "").partition("\n\n")[0]
                yield Code(value, node.name, meaning, path.relative_to(ROOT).as_posix())


def _is_code(said: ast.stmt) -> bool:
    if not isinstance(said, ast.Assign | ast.AnnAssign) or not isinstance(said.value, ast.Constant):
        return False
    targets = said.targets if isinstance(said, ast.Assign) else [said.target]
    names = [target.id for target in targets if isinstance(target, ast.Name)]
    return names == ["code"] and isinstance(said.value.value, str) and bool(said.value.value)


def _phrase(status: str) -> str:
    return f"{status} {OF_OTHERS.get(int(status)) or HTTPStatus(int(status)).phrase}"


def _leaves(base: type[StoneError]) -> Iterator[type[StoneError]]:
    yield base
    for leaf in base.__subclasses__():
        yield from _leaves(leaf)
