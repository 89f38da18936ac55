"""A refusal is one harmless line, whatever it quotes, in this process and in the one that hears of it."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.errors import ShapeError, StoneError, one_line
from stone.findings import Finding


class QuotedError(StoneError):
    code = "quoted"

    def __init__(self, value: str) -> None:
        super().__init__(f"the value is {value}; it should be another")


@given(st.text())
def test_no_sentence_holds_what_cannot_be_printed(text: str) -> None:
    assert one_line(text).isprintable()
    assert str(QuotedError(text)).isprintable()
    assert Finding("TOP-101", "info", "", text).message.isprintable()


@given(st.text().filter(str.isprintable))
def test_what_can_be_printed_stays(text: str) -> None:
    assert one_line(text) == text


@pytest.mark.parametrize(("text", "shown"), [("a\nb", r"a\nb"), ("\x1b[2J", r"\x1b[2J"), ("\u202e", r"\u202e")])
def test_what_cannot_is_spelt_out(text: str, shown: str) -> None:
    assert one_line(text) == shown


def test_a_pickle_carries_the_sentence() -> None:
    error = pickle.loads(pickle.dumps(ShapeError("points", (3, 2), "(N, 3)")))
    assert (type(error), str(error)) == (ShapeError, "points has shape (3, 2); expected (N, 3)")
