"""The reference of all error and finding codes, with the status each is answered with.

**Conventions.** Read off the sources without running them: a class with a `code`, and its docstring's first line.
"""

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

from api.statuses import OF_OTHERS, STATUS_OF, status_of
from docsite.markdown import code, plain, table
from stone.errors import StoneError
from stone_base.codes.catalogue import CATALOGUE, by_family
from stone_base.codes.meaning import HARM_WORDS, CodeMeaning

ROOT = Path(__file__).resolve().parents[1]
CODE_SOURCES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "baselines",
    "services", "simulator", "stone_client", "stone_local", "api", "web",
)  # fmt: skip
HEAD = """# Error and finding codes

Every error and finding has a stable code, and one sentence with the value, the limit and
the likely mistake. Over HTTP it is `application/problem+json` with `code`, `detail`, `request_id` and `errors`; on the
command line `code: sentence` on stderr and exit code 1; of a job its failure. The sentence is for people, the code for
programs.
"""
FINDINGS = """A finding has a severity; what it does to labels follows from its code. On the platform each code has a
page, `/codes/LAB-603`; on the command line `stone explain LAB-603` says the same.
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
    datasets = [one for one in others if one.code[:1].isupper() and one.code not in CATALOGUE]
    rest = [one for one in others if not one.code[:1].isupper() and one.code not in CATALOGUE]
    rows = sorted((str(statuses[one.name]), code(one.code), plain(one.meaning)) for one in answered)
    return "\n".join(
        [
            HEAD,
            "## API errors\n",
            table(("status", "code", ""), ((_phrase(status), *said) for status, *said in rows)),
            "## Findings and failed runs\n",
            FINDINGS,
            *(f"### {title}\n\n{_meanings(codes)}" for title, codes in by_family().items()),
            "## Imported datasets\n",
            table(("code", ""), ((code(one.code), plain(one.meaning)) for one in datasets)),
            "## Submissions, jobs, commands\n",
            table(("code", ""), ((code(one.code), plain(one.meaning)) for one in rest)),
        ]
    )


def _meanings(codes: Iterable[CodeMeaning]) -> str:
    """A table in which `#lab-603` leads to the row of LAB-603."""
    rows = (
        (
            f'<a id="{one.code.lower()}"></a>{code(one.code)}',
            HARM_WORDS[one.harm],
            plain(one.meaning),
            plain(one.remedy),
        )
        for one in codes
    )
    return table(("code", "labels", "meaning", "what to do"), rows)


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
