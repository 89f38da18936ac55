"""The figures of boards as values: axes, the order of rows, brackets, verdicts, Markdown."""

from datetime import UTC, datetime
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api.schemas.base import example_of
from api.schemas.leaderboard import BoardRow, ComparisonAnswer, LeaderboardAnswer, PairItem
from stone.scoring.metric import METRICS
from web.boards.comparison import Names, axis_around_zero, axis_from_zero, axis_over, compared, verdict
from web.boards.rows import ShownBoard, board_with_figures
from web.markdown import html_of

RATIO = st.floats(0, 1, allow_subnormal=False)


@given(st.lists(st.none() | RATIO, max_size=20))
def test_an_axis_holds_every_value_between_its_ends_in_order(values: list[float | None]) -> None:
    known = sorted(value for value in values if value is not None)
    for axis in (axis_over(values), axis_from_zero(values), axis_around_zero(values)):
        assert axis.low < axis.high
        assert all(axis.low - 1e-9 <= value <= axis.high + 1e-9 for value in known)
        places = [axis.place(value) for value in known]
        assert places == sorted(places)
        assert all(0 <= place <= 100 for place in places)


@given(st.lists(RATIO, min_size=1, max_size=20))
def test_ticks_are_few_round_and_evenly_apart(values: list[float]) -> None:
    for axis in (axis_over(values), axis_from_zero(values), axis_around_zero(values)):
        ticks = [tick.value for tick in axis.ticks]
        assert 2 <= len(ticks) <= 8
        assert ticks[0] == pytest.approx(axis.low)
        assert ticks[-1] == pytest.approx(axis.high)
        assert all(b - a == pytest.approx(axis.step) for a, b in pairwise(ticks))
        assert f"{axis.step:.0e}"[0] in "125" or f"{axis.step:.1e}"[:3] == "2.5"


def test_an_axis_around_zero_has_zero_in_the_middle() -> None:
    assert axis_around_zero([-0.012, 0.03]).place(0.0) == pytest.approx(50.0)


def row(method: str, miou: float | None, **said: Any) -> BoardRow:
    ratios = {"miou": miou, "iou_occ": 0.5, "iou_t": 1 - (miou or 0), "iou_p": 0.2, "iou_n": None}
    danger = {"n_predicted_drivable_ratio": said.pop("danger", None), "n_predicted_t_ratio": None}
    return BoardRow.model_validate(
        example_of(BoardRow) | {"method": method, "ratios": ratios, "danger": danger, "rank_interval": None} | said
    )


def a_board(rows: list[BoardRow], sort: Any = "rank", **said: Any) -> ShownBoard:
    described: Any = LeaderboardAnswer.model_config["json_schema_extra"]
    ranked = sum(one.standing == "ranked" for one in rows)
    return board_with_figures(
        LeaderboardAnswer.model_validate(described["examples"][0] | said | {"rows": rows, "ranked_total": ranked}), sort
    )


ROWS = [
    row("b", 0.6, rank=1, tie_group=1, danger=0.2),
    row("a", 0.5, rank=2, tie_group=2, submitted_at=datetime(2026, 7, 1, tzinfo=UTC)),
    row("c", 0.4, rank=3, tie_group=2, danger=0.1),
    row("d", 0.9, standing="baseline", rank=None, tie_group=None),
    row("e", None, standing="reported", rank=None, tie_group=None, submitted_at=None),
]


def methods(board: ShownBoard) -> list[list[str]]:
    return [[one.row.method for one in group.rows] for group in board.groups]


def test_rows_of_a_tie_group_share_one_bracket() -> None:
    assert [[one.tied for one in group.rows] for group in a_board(ROWS).groups] == [[1, 1, 2, 0], [1]]


@pytest.mark.parametrize(
    ("sort", "ranked"),
    [
        ("rank", "dbac"),
        ("miou", "dbac"),
        ("iou_t", "cabd"),
        ("method", "abcd"),
        ("submitted", "adbc"),
        ("danger", "cbda"),
    ],
)
def test_sorting_moves_rows_within_their_standing_and_keeps_their_ranks(sort: Any, ranked: str) -> None:
    board = a_board(ROWS, sort)
    assert methods(board) == [list(ranked), ["e"]]
    assert {one.row.method: one.row.rank for one in board.groups[0].rows} == {"b": 1, "a": 2, "c": 3, "d": None}
    assert board.has_brackets is (sort == "rank")


@pytest.mark.parametrize(("score", "placed"), [(0.9, "dbac"), (0.55, "bdac"), (0.45, "bacd"), (None, "bacd")])
def test_a_baseline_stands_at_its_score_and_never_within_a_tie_group(score: float | None, placed: str) -> None:
    """The winner stood above a baseline that beats it."""
    baseline = row("d", score, standing="baseline", rank=None, tie_group=None)
    assert methods(a_board([*ROWS[:3], baseline])) == [list(placed)]
    assert methods(a_board([baseline])) == [["d"]], "without entries a group of its own"


def test_only_ranked_rows_are_the_best_of_a_column() -> None:
    best = {one.row.method: one.best for group in a_board(ROWS).groups for one in group.rows}
    assert best["b"] == {"miou", "iou_occ", "iou_p"}
    assert "danger" in best["c"], "the lowest"
    assert best["d"] == frozenset()


def test_a_link_keeps_what_was_asked_and_leaves_out_what_is_usual() -> None:
    board = a_board(ROWS, "iou_t", track="C+L", as_of=datetime(2026, 6, 3, 9, 0, 0, 120000, UTC))
    assert board.link(track=None, sort=None) == "/benchmarks/stone/test?as_of=2026-06-03T09%3A00%3A00.120000Z"
    assert board.link(entries="all").startswith("/benchmarks/stone/test?track=C%2BL&sort=iou_t&as_of=")
    assert a_board(ROWS).link() == "/benchmarks/stone/test"
    assert "sort" not in board.file("csv")
    assert board.file("csv").endswith("&format=csv")


def comparison(miou: dict[str, Any], is_withheld: bool = False) -> ComparisonAnswer:
    nothing = {"a": None, "b": None, "difference": None, "these_places": None}
    nothing |= {"new_place": None, "silences": None, "sign_flip": None}
    ratios = dict.fromkeys(("miou", "iou_occ", "iou_t", "iou_p", "iou_n"), nothing) | {"miou": nothing | miou}
    at = {"a": "0" * 32, "b": "1" * 32, "pair": PairItem.model_validate(example_of(PairItem)), "interval_level": 0.95}
    return ComparisonAnswer.model_validate(at | {"is_withheld": is_withheld, "ratios": ratios})


NAMES = Names("Ant", "Bee")
BEHIND = {"a": 0.40, "b": 0.42, "difference": -0.02}
SURE = {"interval": [-0.03, -0.01], "standard_error": 0.005, "degrees_of_freedom": 12.0, "p": 0.0005}
UNSURE = SURE | {"interval": [-0.03, 0.002], "p": 0.2}
HERE, ELSEWHERE = {"these_places": SURE}, {"silences": {"these_places": None, "new_place": "few_sequences"}}
FEW = {"silences": {"these_places": "few_frames", "new_place": "few_sequences"}}


@pytest.mark.parametrize(
    ("miou", "headline", "ground"),
    [
        (BEHIND | HERE, "Bee is better than Ant", "+1.00 to +3.00 (95 % interval, p < 0.001)"),
        (BEHIND | {"these_places": UNSURE}, "No significant difference between Ant and Bee", "−0.20 to +3.00"),
        (BEHIND | HERE | {"new_place": UNSURE}, "Bee is better than Ant", "may not hold"),
        (BEHIND | FEW, "Bee is ahead of Ant; significance unknown", "too few independent frames"),
        ({"a": 0.4, "b": 0.4, "difference": 0.0} | FEW, "Ant and Bee have the same mIoU", ""),
        ({"a": 0.4}, "The two entries cannot be ordered", ""),
    ],
)
def test_the_verdict_says_who_is_better_by_how_much_and_how_surely(
    miou: dict[str, Any], headline: str, ground: str
) -> None:
    found = verdict(comparison(miou), NAMES)
    assert found.headline == headline
    assert ground in " ".join(found.grounds)


def test_a_withheld_comparison_claims_no_more_than_the_rounded_totals() -> None:
    found = compared(comparison(BEHIND, is_withheld=True), NAMES)
    assert found.verdict.headline == "Bee is ahead of Ant; significance unknown"
    assert all(one.these_places is None and one.new_place is None for one in found.rows)


class Parsed(HTMLParser):
    """The text of an HTML fragment, and every tag of it with its attributes."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.text, self.tags = "", set[tuple[str, tuple[str, ...]]]()
        self.feed(str(html))
        self.close()

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add((tag, tuple(name for name, _ in attrs)))


HARMLESS = {"h1", "h2", "h3", "h4", "h5", "h6", "p", "ul", "ol", "li", "em", "strong", "code", "blockquote", "br", "hr"}
FORMULA = ("pre", ("tabindex", "role", "aria-label"))


@pytest.mark.parametrize("version", METRICS)
def test_no_word_of_a_definition_is_lost_but_its_title(version: str) -> None:
    title, _, definition = METRICS[version].definition.partition("\n")
    found = Parsed(html_of(definition))
    plain = definition.replace("`", "").replace("*", "").replace("#", "").replace("\n- ", "\n")
    assert "".join(found.text.split()) == "".join(plain.split())
    assert found.tags == {("h2", ()), ("p", ()), ("ul", ()), ("li", ()), ("em", ()), ("code", ()), FORMULA}
    assert html_of(f"{title}\n{definition}") == html_of(definition)


@given(st.lists(st.sampled_from(["<", ">", "[", "](", ")", "!", "`", "\n", "    ", "#", "- ", "&", '"', "a", "x:"])))
def test_whatever_markdown_says_is_harmless_html(pieces: list[str]) -> None:
    for tag, attributes in Parsed(html_of("".join(pieces))).tags - {FORMULA}:
        assert tag in HARMLESS
        assert set(attributes) <= {"start"}
