"""Every way in which a file can be refused has words that a participant can act on, and groups keep their order."""

from api.schemas.submissions import FileProblem
from stone_submissions import errors
from stone_submissions.errors import SubmissionError
from web.problem_words import ADVICE, UNKNOWN, grouped


def problem(code: str, file: str) -> FileProblem:
    return FileProblem(code=code, file=file, frame=None, expected="a", actual="b")


def test_every_refusal_of_a_file_has_words_and_no_words_are_left_over() -> None:
    leaves = {kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, SubmissionError)}
    assert {leaf.code for leaf in leaves - {SubmissionError}} == set(ADVICE)


def test_problems_stand_in_groups_the_largest_first_each_as_it_was_found() -> None:
    found = [problem("bad_shape", "1"), problem("bad_dtype", "2"), problem("news", "3"), problem("bad_dtype", "4")]
    groups = grouped(found)
    assert [(group.code, [one.file for one in group.problems]) for group in groups] == [
        ("bad_dtype", ["2", "4"]),
        ("bad_shape", ["1"]),
        ("news", ["3"]),
    ]
    assert groups[2].advice == UNKNOWN
    assert grouped([]) == []
