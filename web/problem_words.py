"""Problems of a submission's files, grouped and explained for participants.

**Conventions.** Every code of a refused submission has a text (a test compares both lists); an unknown code is shown
unchanged.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from api.schemas.submissions import FileProblem
from stone_submissions.errors import hint_of

ADVICE = {
    "missing_frame": "A submission holds every frame of the manifest. Was the prediction loop cut short?",
    "unexpected_file": "The zip holds only <frame_token>.npz files, all in one folder or all at the top level.",
    "other_layout": "The zip holds only <frame_token>.npz files, all in one folder or all at the top level.",
    "duplicate_frame": "Each frame occurs once. Was the archive appended to instead of rewritten?",
    "not_zip": "A submission is one zip of .npz files. Was it cut short while it was copied?",
    "not_npz": "Write each frame with numpy.savez_compressed(path, semantics=grid).",
    "truncated": "The file ends before it should. Was it cut short while it was written or copied?",
    "corrupt": "Bytes changed after they were written. Write the zip again and send it again.",
    "too_large": "A frame is one uint8 grid. Was it saved as int64, or with more arrays?",
    "extra_array": "Save the prediction alone, one array a file.",
    "missing_array": "Name the array: numpy.savez_compressed(path, semantics=grid).",
    "bad_shape": "Axes are x, y, z, in C order.",
    "bad_dtype": "Cast with .astype(numpy.uint8) before saving.",
    "label_out_of_range": "0 is free, 1 T, 2 P, 3 N. Is “unknown” written as 255, or a different class map used?",
    "encrypted": "Password-protected archives are not accepted.",
    "unsupported_zip": "Zip with deflate or store, in one part, as zip and Python's zipfile do.",
    "overlapping_files": "Entries of the zip overlap. Write it again.",
    "symlink": "Zip the files themselves, not links to them.",
}
UNKNOWN = "If the code does not explain it, ask the benchmark's organisers."


@dataclass(frozen=True)
class ProblemGroup:
    """The shown problems of one code, in the order they were found."""

    code: str
    advice: str
    problems: tuple[FileProblem, ...]


def grouped(problems: Iterable[FileProblem]) -> list[ProblemGroup]:
    """Group problems by code, the most frequent first, and equally frequent ones in the order of occurrence."""
    by_code: dict[str, list[FileProblem]] = {}
    for problem in problems:
        by_code.setdefault(problem.code, []).append(problem)
    groups = [
        ProblemGroup(code, _advice(code, problems_of_code), tuple(problems_of_code))
        for code, problems_of_code in by_code.items()
    ]
    return sorted(groups, key=lambda group: -len(group.problems))


def _advice(code: str, problems: Sequence[FileProblem]) -> str:
    """Return the advice; for a shape or layout, the fix of the first problem."""
    if code not in ("bad_shape", "other_layout"):
        return ADVICE.get(code, UNKNOWN)
    hint = hint_of(code, problems[0].expected, problems[0].actual)
    return f"{hint[0].upper()}{hint[1:]}."
