"""The check of our English finds what breaks a rule and lets the better sentence pass."""

from pathlib import Path

import pytest

from testing.english.exceptions import exceptions, without_exceptions
from testing.english.rules import hits
from testing.english.sample import SHARES, draw
from testing.english.sentences import sentences, word_count
from testing.english.texts import ROOT, Source, Text, texts_of, tracked

PAIRS = [
    ("clause as subject", Source.DOCS, "What is unobserved is free.", "Unobserved voxels are free."),
    ("clause as subject", Source.DOCS, "Of a hidden phase no frame is shown.", "A hidden phase shows no frame."),
    ("of which", Source.DOCS, "A tar of which no copy is written.", "A tar stream, without a temporary copy."),
    ("program that speaks", Source.STRING, "The header says which file it is.", "The header names the file."),
    ("by itself", Source.DOCS, "It runs again by itself once a recording is added.", "It runs again automatically."),
    ("begun", Source.DOCS, "Begun again, it goes on where it was.", "Run the command again to resume the import."),
    ("nobody", Source.DOCS, "Nobody sees a hidden phase.", "A hidden phase is visible to no one."),
    ("where for if", Source.DOCSTRING, "Return the file; None where there is none.", "Return the file, or None."),
    ("docstring begins with a clause", Source.DOCSTRING, "How a row is trained.", "Settings of a row's training."),
    ("function without a verb", Source.FUNCTION, "The voxel key of each point.", "Return the voxel key of each point."),
    ("cell without a subject", Source.CELL, "else the standard output", "Output file (default: stdout)"),
    ("name without a noun", Source.NAME, "found", "frames"),
    ("long", Source.DOCS, f"A path of {'very ' * 30} long words.", f"A path of {'very ' * 20} long words."),
]


@pytest.mark.parametrize(("rule", "source", "bad", "good"), PAIRS)
def test_each_rule_finds_the_bad_sentence_and_not_the_better_one(
    rule: str, source: Source, bad: str, good: str
) -> None:
    assert rule in {hit.rule for hit in hits(Text("page.md", 1, source, bad))}
    assert list(hits(Text("page.md", 1, source, good))) == []


def test_questions_and_titles_may_begin_with_a_clause() -> None:
    assert list(hits(Text("faq.md", 1, Source.DOCS, "What does this code mean?"))) == []
    assert list(hits(Text("faq.md", 1, Source.HEADING, "What the page shows"))) == []


def test_sentences_are_split_at_their_ends_alone() -> None:
    text = "Use `stone a.b` (e.g. in CI). The [page](x.md) shows 1.4 % of voxels. `x` is next."
    assert sentences(text) == ["Use code (e.g. in CI).", "The page shows 1.4 % of voxels.", "code is next."]
    assert word_count("`a`, `b` and `c` are keys".replace("`", "")) == 6
    assert sentences("`a`, `b` and `c` are keys.") == ["code are keys."]


FILES = {
    "page.md": "# What it does\n\nNobody\nreads it.\n\n```\nNobody reads code.\n```\n\n| a | Nobody reads cells |\n",
    "page.html": "<p>Nobody reads {{ name }} <b>twice today</b></p>{# Nobody #}<script>nobody is here at all</script>",
    "page.ts": "// Nobody reads\n// these two lines.\nconst words = `Nobody reads ${this} one now`;\n",
    "page.py": '"""Nobody reads it."""\nNAME = f"Nobody reads {NAME} at noon too"  # nobody reads\nkey = "nobody"\n',
}


@pytest.mark.parametrize(
    ("name", "lines"), [("page.md", [3, 10]), ("page.html", [1]), ("page.ts", [1, 3]), ("page.py", [1, 2, 2])]
)
def test_texts_of_each_kind_of_file_are_read(tmp_path: Path, name: str, lines: list[int]) -> None:
    (tmp_path / name).write_text(FILES[name], "utf-8")
    assert (
        sorted(hit.text.line for text in texts_of(name, tmp_path) for hit in hits(text) if hit.rule == "nobody")
        == lines
    )


def test_every_kind_of_file_of_the_checkout_gives_texts() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout, so no list of the project's files")
    paths = tracked()
    for path in ("README.md", "web/templates/help.html", "web/modules/tus.ts", "stone_base/codes/labels.py"):
        assert path in paths
        assert any(word_count(text.words) > 5 for text in texts_of(path))


def test_an_exception_needs_a_reason_and_a_hit(tmp_path: Path) -> None:
    entry = '[[exception]]\npath = "a.md"\nrule = "nobody"\npart = "Nobody"\nreason = "{}"\n'
    listed = tmp_path / "exceptions.toml"
    listed.write_text(entry.format(" "), "utf-8")
    with pytest.raises(ValueError, match="reason"):
        exceptions(listed)
    listed.write_text(entry.format("a quotation"), "utf-8")
    (exempted,) = exceptions(listed)
    (hit,) = hits(Text("a.md", 1, Source.DOCS, "Nobody came."))
    (other,) = hits(Text("b.md", 1, Source.DOCS, "Nobody came."))
    assert exempted.holds(hit)
    assert not exempted.holds(other)
    assert without_exceptions([other])[0] == [other]


def test_a_sample_is_drawn_by_stratum_and_repeats_with_its_seed() -> None:
    texts = [
        Text(path, line, source, f"Sentence number {line} of this page.")
        for line in range(200)
        for path, source in (
            ("docs/a.md", Source.DOCS),
            ("stone_client/commands/a.py", Source.DOCSTRING),
            ("web/templates/a.html", Source.PAGE),
            ("api/a.py", Source.STRING),
        )
    ]
    sample = list(draw(texts, 150, seed=7))
    assert {stratum: sum(name == stratum for name, _, _ in sample) for stratum in SHARES} == dict(SHARES)
    assert sample == list(draw(texts, 150, seed=7))
    assert sample != list(draw(texts, 150, seed=8))
