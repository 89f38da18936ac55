"""The reference of all error and finding codes, with their HTTP status.

**Conventions.** Meanings come from the tables of codes; `raised_codes` parses the sources without running them.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from http import HTTPStatus
from pathlib import Path

from api.statuses import OF_OTHERS, PROBLEM_TYPES
from docsite.markdown import code, plain, table
from docsite.other_codes import OTHER_CODES
from stone_base.codes.catalogue import by_family
from stone_base.codes.meaning import HARM_WORDS, CodeMeaning
from stone_files.dataset_faults import DATASET_FAULTS
from stone_submissions.errors import MISTAKES

ROOT = Path(__file__).resolve().parents[1]
CODE_SOURCES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "baselines",
    "services", "simulator", "stone_client", "stone_local", "api", "web",
)  # fmt: skip
HEAD = """# Error and finding codes

Every error and finding has a stable code for programs, and a sentence for people with the value, the limit and the
likely mistake. The API returns `application/problem+json` with `code`, `detail`, `request_id` and `errors`. Commands
print `code: sentence` on stderr and exit with code 1. A failed job has both in its failure.
"""
FINDINGS = """A finding has a severity; its code determines the effect on labels. On the platform each code has a
page, such as `/codes/LAB-603`; `stone explain LAB-603` prints the same text.
"""
REFUSALS = (
    "Refused",
    "PlatformFaultError",
    "IngestError",
    "DatasetFaultError",
    "SubmissionError",
    "ZipFaultError",
    "ApiError",
    "ExhaustedError",
    "problem",
    "__init__",
)
"""The names of calls whose first argument is the code."""
CODE = re.compile(r"[A-Z]{3}-\d{3}|[a-z][a-z0-9_]*")


def codes_page() -> str:
    """Return the page."""
    answered = sorted((str(kind.status), code(entry), plain(f"{kind.title}.")) for entry, kind in PROBLEM_TYPES.items())
    datasets = [
        (code(entry), plain(fault.meaning)) for entry, fault in DATASET_FAULTS.items() if entry not in PROBLEM_TYPES
    ]
    others = sorted([*((entry, "") for entry in MISTAKES), *OTHER_CODES], key=lambda row: row[0])
    return "\n".join(
        [
            HEAD,
            "## API errors\n",
            table(("status", "code", ""), ((_phrase(status), *cells) for status, *cells in answered)),
            "## Findings and failed runs\n",
            FINDINGS,
            *(f"### {title}\n\n{_meanings(codes)}" for title, codes in by_family().items()),
            "## Imported datasets\n",
            table(("code", ""), datasets),
            "## Submissions, jobs, commands\n",
            table(("code", ""), ((code(entry), plain(meaning)) for entry, meaning in others)),
        ]
    )


def _meanings(codes: Iterable[CodeMeaning]) -> str:
    """Return a table in which `#lab-603` leads to the row of LAB-603."""
    rows = (
        (
            f'<a id="{entry.code.lower()}"></a>{code(entry.code)}',
            HARM_WORDS[entry.harm],
            plain(entry.meaning),
            plain(entry.remedy),
        )
        for entry in codes
    )
    return table(("code", "labels", "meaning", "what to do"), rows)


def raised_codes() -> set[str]:
    """Return every code that the sources raise: a class's own, or the first argument of a refusal."""
    paths = (path for folder in CODE_SOURCES for path in (ROOT / folder).rglob("*.py"))
    return {code for path in paths for code in _codes_of(path)}


def _codes_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ClassDef):
            own = [assignment for assignment in node.body if isinstance(assignment, ast.Assign | ast.AnnAssign)]
            texts = [
                text
                for assignment in own
                if ast.unparse(assignment).split()[0].rstrip(":") == "code"
                for text in _texts(assignment.value)
            ]
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in REFUSALS:
            arguments = [argument for argument in node.args if ast.unparse(argument) != "self"][:1]
            texts = [text for argument in arguments for text in _texts(argument)]
        else:
            continue
        yield from filter(CODE.fullmatch, texts)


def _texts(node: ast.expr | None) -> list[str]:
    if isinstance(node, ast.IfExp):
        return _texts(node.body) + _texts(node.orelse)
    if isinstance(node, ast.BoolOp):
        return [text for value in node.values for text in _texts(value)]
    return [node.value] if isinstance(node, ast.Constant) and isinstance(node.value, str) else []


def _phrase(status: str) -> str:
    return f"{status} {OF_OTHERS.get(int(status)) or HTTPStatus(int(status)).phrase}"
