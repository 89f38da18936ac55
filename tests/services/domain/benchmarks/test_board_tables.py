"""A board as a file: the same facts in every form, and nothing that a stranger wrote is more than text in any."""

import csv
import io
import re
from dataclasses import replace
from itertools import pairwise

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from services.domain.benchmarks.boards.board import Board, BoardEvaluationVersion, LeaderboardRow
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.tables import (
    Form,
    columns,
    csv_text,
    latex_text,
    markdown_text,
    table_bytes,
)
from stone.errors import one_line

HOSTILE = (
    r"\input{x}",
    "=cmd()|' /C calc'!A0",
    "+1",
    "-1+1",
    "@SUM(1)",
    "\t=1",
    " =1",
    "\uff1d1",
    "a;=HYPERLINK(1)",
    "a,=1",
    '"=1"',
    "a | b",
    "<script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "[x](javascript:alert(1))",
    "![x](http://evil)",
    "http://evil.example",
    "www.evil.example",
    "a@evil.example",
    "`code`",
    "*b* _i_ ~s~ #h",
    "&lt;b&gt;",
    "$x$ ^^41 %c #1 {\\",
    "a\\\\[9cm]",
    "line\nbreak\r\\end{tabular}",
    "\u202eabc",
    "Ünï 道路",
)
RATIOS = {"iou_occ": 0.5, "iou_t": 0.25, "iou_p": 0.125, "iou_n": None, "miou": 0.43216}
PAIR = BoardEvaluationVersion("t" * 32, 3, "5" * 64, "stone-iou-2", "metric:stone-iou-2|truth:5", 10**18, 7012, 5, 5)
ROW = LeaderboardRow(
    standing="ranked",
    method="Net",
    modality="C+L",
    ratios=RATIOS,
    rank=1,
    rank_interval=(1, 2),
    tie_group=1,
    submission_id="a" * 32,
    team="Gang",
    intervals={**dict.fromkeys(RATIOS, (0.1, 0.9)), "iou_n": None},
    danger={"n_predicted_drivable_ratio": 0.1224, "n_predicted_t_ratio": 0.0591},
    submitted_ns=1_780_000_000 * 10**9,
)
REPORTED = LeaderboardRow(
    standing="reported", method="Old", modality="C", ratios=dict.fromkeys(RATIOS), source="a paper"
)

CEILING = LeaderboardRow("ceiling", "Twice", "L", {**RATIOS, "miou": 0.781}, source="even and odd", percent_digits=1)


def board_of(*rows: LeaderboardRow) -> Board:
    return Board("stone", "test", BoardQuery(), "open", False, PAIR, len(rows), rows)


def table(form: Form, *rows: LeaderboardRow) -> str:
    return table_bytes(board_of(*rows), form).decode()


def csv_rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_csv_and_parquet_say_the_same() -> None:
    rows = csv_rows(table("csv", ROW, REPORTED))
    read = pq.read_table(io.BytesIO(table_bytes(board_of(ROW, REPORTED), "parquet"))).to_pylist()
    assert [list(row) for row in (*rows, *read)] == [list(columns())] * 4
    for spelled, typed in zip(rows, read, strict=True):
        assert {name: str("" if value is None else value) for name, value in typed.items()} == spelled
    assert (read[0]["miou"], read[0]["iou_n"], read[0]["miou_low"], read[0]["iou_n_low"]) == (0.43216, None, 0.1, None)
    assert (read[0]["rank"], read[0]["rank_low"], read[0]["rank_high"], read[1]["rank"]) == (1, 1, 2, None)
    assert (read[0]["signature"], read[1]["signature"]) == (PAIR.signature, None)
    assert (read[0]["n_predicted_drivable_ratio"], read[0]["n_predicted_t_ratio"]) == (0.1224, 0.0591)
    assert read[1]["n_predicted_drivable_ratio"] is None
    assert read[0]["submitted_at"] == "2026-05-28T20:26:40Z"


def test_markdown_is_a_table_for_people() -> None:
    text = table("md", ROW, REPORTED)
    assert r"| 1 [1, 2] | Gang | Net | C\+L | 43.22 | 50.00 | 25.00 | 12.50 | -- | 12.24 | 5.91 |" in text
    assert "| reported |  | Old | C | -- | -- | -- | -- | -- | -- | -- |" in text
    assert "Reported: a paper." in text
    assert "predicted T or P, and predicted T alone; lower is better" in text
    assert "lower is better" not in table("md", REPORTED)


@pytest.mark.parametrize("form", ["csv", "md", "tex"])
def test_a_ceiling_is_a_row_of_its_own_kind_with_its_source(form: Form) -> None:
    text = table(form, CEILING, ROW, REPORTED)
    cut = {"csv": ",", "md": " | ", "tex": " & "}[form]
    (line,) = [line for line in text.splitlines() if "Twice" in line]
    assert line.strip("| ").startswith(f"ceiling{cut}")
    if form == "csv":
        (row, *_) = csv_rows(text)
        assert (row["standing"], row["rank"], row["signature"], row["miou"]) == ("ceiling", "", "", "0.781")
    else:
        assert f"{cut}78.1{cut}50.0{cut}" in line
        assert "Ceiling: even and odd. Reported: a paper." in text
        assert "no entry can be expected to score above it" in text


PRINTED = replace(
    REPORTED,
    ratios={"iou_occ": 0.612, "iou_t": 0.211, "iou_p": 0.334, "iou_n": 0.552, "miou": 0.365},
    note="of another | split",
    percent_digits=1,
)


def test_a_reported_row_keeps_the_digits_it_was_printed_with_and_its_note() -> None:
    rows = (ROW, PRINTED, replace(PRINTED, modality="C+L"), REPORTED)
    for form, cut in (("md", " | "), ("tex", " & ")):
        text = table(form, *rows)
        assert cut.join(["36.5", "61.2", "21.1", "33.4", "55.2"]) in text
        assert cut.join(["43.22", "50.00"]) in text, "ours keep two"
    assert "Old \\(C\\), Old \\(C\\+L\\): of another \\| split" in table("md", *rows)
    assert "Old (C), Old (C+L): of another | split" in table("tex", *rows).replace("\\textbar{}", "|")
    assert [row["note"] for row in csv_rows(table("csv", *rows))] == ["", PRINTED.note, PRINTED.note, ""]
    assert csv_rows(table("csv", *rows))[1]["iou_occ"] == "0.612"


def test_latex_is_a_booktabs_table() -> None:
    text = table("tex", ROW, REPORTED)
    assert "1 [1, 2] & Gang & Net & C+L & 43.22 & 50.00 & 25.00 & 12.50 & -- & 12.24 & 5.91 \\\\" in text
    body = [line for line in text.splitlines() if not line.startswith("%")]
    assert (body[0], body[1], body[3], body[-2], body[-1]) == (
        r"\begin{tabular}{rlllrrrrrrr}",
        r"\toprule",
        r"\midrule",
        r"\bottomrule",
        r"\end{tabular}",
    )
    assert all(line.count("&") == 10 for line in body[4:-2])


@pytest.mark.parametrize("form", ["csv", "parquet", "md", "tex"])
def test_an_empty_board_is_a_table_too(form: Form) -> None:
    empty = replace(board_of(), pair=None)
    assert table_bytes(empty, form) == table_bytes(empty, form) != b""


@pytest.mark.parametrize("text", HOSTILE)
def test_no_cell_of_a_csv_is_computed(text: str) -> None:
    hostile = replace(ROW, method=text, team=text)
    (row,) = csv_rows(table("csv", hostile))
    for cell in (row["method"], row["team"]):
        assert not re.match(r"\s*[=+\-@\uff1d\uff0b\uff0d\uff20]", cell)
        assert not re.search(r"[;,\t]\s*[=+\-@]", cell)
        assert cell.isprintable()


@pytest.mark.parametrize("text", HOSTILE)
def test_parquet_keeps_a_text_as_it_is(text: str) -> None:
    read = pq.read_table(io.BytesIO(table_bytes(board_of(replace(ROW, method=text)), "parquet")))
    assert read["method"].to_pylist() == [text]


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_opens_html_links_or_cells_in_markdown(text: str) -> None:
    rows = table("md", replace(ROW, method=text, team=text)).splitlines()
    line = next(line for line in rows if "43.22" in line)
    assert len(re.findall(r"(?<!\\)\|", line)) == 12
    for character in "<>@`[]*_$":
        shown = line.replace("1 [1, 2]", "")
        assert not re.search(rf"(?<!\\){re.escape(character)}", shown), character
    assert "://" not in line
    assert "www." not in line


@pytest.mark.parametrize("text", HOSTILE)
def test_a_markdown_reader_reads_the_text_as_it_was_written(text: str) -> None:
    tokens = MarkdownIt("commonmark").enable("table").parse(table("md", replace(ROW, method=text)))
    cells = [token for before, token in pairwise(tokens) if before.type == "td_open"]
    assert len(cells) == 11
    children = cells[2].children or []
    assert {child.type for child in children} <= {"text", "text_special"}
    assert "".join(child.content for child in children) == one_line(text).strip()


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_is_a_command_in_latex(text: str) -> None:
    assert unescaped(latex_text(text)) == []
    lines = table("tex", replace(ROW, method=text, team=text)).splitlines()
    assert len([line for line in lines if line.endswith(r" \\")]) == 2


@given(st.text(max_size=40))
def test_any_text_is_harmless_and_on_one_line(text: str) -> None:
    assert unescaped(latex_text(text)) == []
    for shown in (csv_text(text), markdown_text(text), latex_text(text)):
        assert shown.isprintable()
    assert not re.match(r"\s*[=+\-@]", csv_text(text))
    assert not set(markdown_text(text)) & set("<>@$^=\"'/:")


@given(st.text(alphabet=st.characters(categories=["L", "N"]), max_size=20))
def test_letters_and_digits_stay_as_they_are(text: str) -> None:
    assert (csv_text(text), markdown_text(text), latex_text(text)) == (text, text, text)


def unescaped(latex: str) -> list[str]:
    """What TeX would take for more than a character, beyond the escapes we know: a tokenizer of its own."""
    known = re.compile(
        r"\\(?:text(?:backslash|asciicircum|asciitilde|less|greater|bar)\{\}|[{}$&#%_])|\{\\char34\}|\{[\[\]`*]\}"
    )
    return re.findall(r"[\\{}$&#%_^~<>|\"`\[\]*]", known.sub("", latex))
