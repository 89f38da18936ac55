"""Leaderboard files: CSV and Parquet for programs, Markdown and LaTeX for papers.

**Conventions.** CSV and Parquet contain ratios. Markdown and LaTeX contain percentages with two decimals; a reported
row keeps its printed decimals. Null is an empty cell or a dash. Each file names the evaluation version of its scores;
the LaTeX table needs `booktabs`. Untrusted texts are escaped (`plain_text.py`).
"""

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from services.domain.benchmarks.boards.board import Board, BoardEvaluationVersion, LeaderboardRow
from stone.errors import one_line
from stone.scoring.confusion import DANGERS
from stone.scoring.intervals import FEWEST_SEQUENCES, SILENCES
from stone_base.counts import counted

Form = Literal["csv", "parquet", "md", "tex"]
MEDIA_TYPES: Mapping[Form, str] = {
    "csv": "text/csv; charset=utf-8",
    "parquet": "application/vnd.apache.parquet",
    "md": "text/markdown; charset=utf-8",
    "tex": "application/x-tex; charset=utf-8",
}
RATIO_NAMES = ("miou", "iou_occ", "iou_t", "iou_p", "iou_n")
HEADINGS = ("mIoU", "IoU occ", "IoU T", "IoU P", "IoU N", "Danger", "Danger T")
TEXTS = (
    "standing", "team", "method", "modality", "source", "note", "submitted_at", "submission_id", "metric", "signature"
)  # fmt: skip
OF_ROW = ("standing", "rank", "tie_group", "team", "method", "modality", "source", "note", "submission_id")
NUMBERS = ("rank", "rank_low", "rank_high", "tie_group")
FEW_SEQUENCES = 10

Cell = str | int | float | None


def table_bytes(board: Board, form: Form) -> bytes:
    """Return the board as a file of this format; equal boards give equal bytes."""
    writers: Mapping[Form, Callable[[Board], bytes]] = {
        "csv": _csv,
        "parquet": _parquet,
        "md": _markdown,
        "tex": _latex,
    }
    return writers[form](board)


def cells(board: Board, row: LeaderboardRow) -> dict[str, Cell]:
    """Return a row's cells by column name."""
    low, high = row.rank_interval or (None, None)
    values: dict[str, Cell] = {name: getattr(row, name) for name in OF_ROW} | {"rank_low": low, "rank_high": high}
    for name in RATIO_NAMES:
        bounds = (row.intervals or {}).get(name) or (None, None)
        values |= {name: row.ratios[name], f"{name}_low": bounds[0], f"{name}_high": bounds[1]}
    of_ours = row.source is None and board.pair is not None
    return (
        values
        | _danger(row)
        | {
            "submitted_at": None if row.submitted_ns is None else _moment(row.submitted_ns),
            "metric": board.pair.metric if of_ours and board.pair else None,
            "signature": board.pair.signature if of_ours and board.pair else None,
        }
    )


def columns() -> tuple[str, ...]:
    """Return the column names, in order."""
    bounded = [f"{name}{end}" for name in RATIO_NAMES for end in ("", "_low", "_high")]
    return ("standing", *NUMBERS, *TEXTS[1:4], *bounded, *DANGERS, *TEXTS[4:])


def _csv(board: Board) -> bytes:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(columns())
    for row in board.rows:
        values = cells(board, row)
        writer.writerow([_format_cell(values[name]) for name in columns()])
    return out.getvalue().encode()


def _format_cell(cell: Cell) -> Cell:
    return csv_text(cell) if isinstance(cell, str) else cell


def _parquet(board: Board) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = [cells(board, row) for row in board.rows]
    kinds: dict[str, Any] = dict.fromkeys(NUMBERS, pa.int64()) | dict.fromkeys(TEXTS, pa.string())
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in columns()])
    out = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), out, compression="zstd")
    return bytes(out.getvalue())


def _markdown(board: Board) -> bytes:
    lines = [f"# {_title(board)}", "", _made_by(board, "`"), ""]
    lines.append(f"| Rank | Team | Method | Modality | {' | '.join(HEADINGS)} |")
    lines.append(f"|---:|---|---|---|{'---:|' * len(HEADINGS)}")
    for row in board.rows:
        texts = [markdown_text(text) for text in (row.team or "", row.method, row.modality)]
        lines.append(f"| {' | '.join([_rank(row), *texts, *_percents(row)])} |")
    return ("\n".join([*lines, "", _notes(board, markdown_text), ""])).encode()


def _latex(board: Board) -> bytes:
    lines = [
        f"% {latex_text(_title(board))}",
        f"% {latex_text(_made_by(board))}",
        r"\begin{tabular}{rlll" + "r" * len(HEADINGS) + "}",
        r"\toprule",
        f"Rank & Team & Method & Modality & {' & '.join(HEADINGS)} \\\\",
        r"\midrule",
    ]
    for row in board.rows:
        texts = [latex_text(text) for text in (row.team or "", row.method, row.modality)]
        lines.append(" & ".join([_rank(row), *texts, *_percents(row)]) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", f"% {latex_text(_notes(board, str))}", ""]
    return "\n".join(lines).encode()


def _title(board: Board) -> str:
    return f"{board.benchmark} / {board.phase}"


def _made_by(board: Board, quote: str = "") -> str:
    """Return the sentence on the evaluation version, with the signature between two of `quote`."""
    pair = board.pair
    if pair is None:
        return "No ground truth is ready yet."
    signature = f"{quote}{pair.signature}{quote}" if pair.signature else "no score yet"
    return (
        f"Track {board.query.track}, entries {board.query.entries}; metric {pair.metric}, ground truth "
        f"{pair.truth_number}, {pair.frames} frames of {_amount(pair)}; {signature}"
    )


def _notes(board: Board, plain: Callable[[str], str]) -> str:
    """Return the notes as one text; `plain` escapes untrusted texts."""
    reported = [
        f"{title}: {'; '.join(map(plain, sources))}."
        for title, standing in (("Ceiling", "ceiling"), ("Reported", "reported"))
        if (sources := dict.fromkeys(row.source or "" for row in board.rows if row.standing == standing))
    ]
    by_row = [f"{plain(', '.join(rows))}: {plain(note)}" for note, rows in _rows_by_note(board).items()]
    return " ".join(["Per cent. Rank with its 95 % interval.", *notes(board), *reported, *by_row])


def _rows_by_note(board: Board) -> Mapping[str, list[str]]:
    """Return the notes of reported rows and ceilings, each with the methods of its rows."""
    rows: dict[str, list[str]] = {}
    for row in board.rows:
        if row.note is not None:
            rows.setdefault(row.note, []).append(f"{row.method} ({row.modality})")
    return rows


def notes(board: Board) -> Iterator[str]:
    """Yield notes for the reader of the board."""
    if board.silence is None:
        yield (
            "No entry of a tie group differs significantly from the group's first entry (all pairs tested jointly, "
            "95 %)."
        )
        if board.rank_scope == "new_place":
            yield f"Differences are tested over whole sequences: {SILENCES['few_frames']}."
    else:
        yield f"No ties and no intervals of ranks: {SILENCES[board.silence]}."
    if any(row.standing == "ceiling" for row in board.rows):
        yield "The ceiling is the same drive labelled twice; no entry can be expected to score above it."
    if any(row.danger is not None for row in board.rows):
        yield "Danger: share of non-traversable voxels predicted T or P, and predicted T alone; lower is better."
    yield "Baselines are not ranked. Reported rows were published elsewhere and not scored on this platform."
    drives = board.pair.drives if board.pair is not None else FEW_SEQUENCES
    here = _amount(board.pair) if board.pair is not None else ""
    if drives < FEWEST_SEQUENCES:
        yield f"No statement about unseen places: {SILENCES['few_sequences']}, this phase has {here}."
    elif drives < FEW_SEQUENCES:
        yield (
            f"This phase has only {here}: the exact test over whole drives cannot give a p below "
            f"{2.0 ** (1 - drives):g}, however large the difference is."
        )
    if board.secrecy == "running":
        yield (
            "The ground truth is hidden. Until the phase ends, values are rounded to 4 digits and only "
            "administrators see danger."
        )


def _amount(pair: BoardEvaluationVersion) -> str:
    chunks = counted(pair.sequences, "sequence")
    return chunks if pair.drives == pair.sequences else f"{counted(pair.drives, 'drive')} in {chunks}"


def _rank(row: LeaderboardRow) -> str:
    if row.rank is None:
        return "--" if row.standing == "undefined" else row.standing
    if row.rank_interval is None:
        return str(row.rank)
    return f"{row.rank} [{row.rank_interval[0]}, {row.rank_interval[1]}]"


def _percents(row: LeaderboardRow) -> list[str]:
    ratios, digits = (*(row.ratios[name] for name in RATIO_NAMES), *_danger(row).values()), row.percent_digits
    return ["--" if value is None else f"{100 * round(value, digits + 2):.{digits}f}" for value in ratios]


def _danger(row: LeaderboardRow) -> dict[str, float | None]:
    return {name: (row.danger or {}).get(name) for name in DANGERS}


def _moment(moment_ns: int) -> str:
    return datetime.fromtimestamp(moment_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


# Escaping of untrusted text for CSV, Markdown and LaTeX. `one_line` first escapes unprintable characters, so no text
# spans lines. CSV: spreadsheets execute cells that start with = + - @, also after a separator at which they split, so
# an apostrophe is prefixed (OWASP, CSV injection). Markdown: HTML and links become character references, other
# punctuation gets backslashes (CommonMark 0.31 §2.4, §2.5). LaTeX: only letters, digits and spaces stay unescaped.


FORMULA = re.compile(r"(^|[;,\t|])(\s*)([=+\-@\uff1d\uff0b\uff0d\uff20])")
MARKDOWN = {character: f"\\{character}" for character in "\\`*_{}[]()#+-.!|~"} | {
    character: f"&#{ord(character)};" for character in "&<>:@/$^=\"'"
}
LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"{\char34}",
    "`": "{`}",
    "[": "{[}",
    "]": "{]}",
    "*": "{*}",
}


def csv_text(text: str) -> str:
    """Return the text as a cell that no spreadsheet evaluates; the CSV writer adds quotes."""
    return FORMULA.sub(r"\1\2'\3", one_line(text))


def markdown_text(text: str) -> str:
    """Return the text escaped for a table cell."""
    return "".join(MARKDOWN.get(character, character) for character in one_line(text))


def latex_text(text: str) -> str:
    """Return the text escaped for LaTeX without packages."""
    return "".join(LATEX.get(character, character) for character in one_line(text))
