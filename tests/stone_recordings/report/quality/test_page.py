"""The page is one well-formed file without script, says in words what it draws, and shows hostile names as text."""

import json
import re
import shutil
import subprocess
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.findings import Finding
from stone_base.codes.catalogue import CATALOGUE
from stone_recordings.bags.bag import Topic
from stone_recordings.clocks.report import ClockReport, ImuLag, TopicClock
from stone_recordings.clocks.timing import measure
from stone_recordings.report.inspection import InspectedTopic, Inspection
from stone_recordings.report.quality.facts import CameraFacts, Coverage, Facts, LidarFacts, RadarFacts, RtkFacts
from stone_recordings.report.quality.markup import plain, text
from stone_recordings.report.quality.page import quality_page
from stone_recordings.report.quality.report import Quality
from stone_recordings.report.quality.score import Deduction
from tests.stone_recordings.report.quality import recordings
from tests.stone_recordings.report.quality.recordings import measured, ticks
from tests.stone_recordings.rigs import written

HOSTILE = "</style><script>alert(1)</script><img src=x onerror=alert(1)>$\\frac{a}{0}$ \x1b[2J\u202egpj.exe & \"'"
VOID = {"meta", "img", "br"}
S = 10**9


class Document(HTMLParser):
    """Every element with its attributes; `faults` are tags that do not match."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.faults: list[str] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def hostile_page(name: str = HOSTILE) -> str:
    """Everything a page can show, under names that mean harm."""
    at = (0, S, 2 * S)
    facts = Facts(
        1_700_000_000 * S,
        (
            Coverage(name, "camera", 3, 10.0, 0, 2 * S, 0.9, (1.0, 0.5, 0.0), (10.0, 5.0), ((S, 2 * S),)),
            Coverage(name, "tf_static", 1, None, 0, 0, None, (), ()),
        ),
        (CameraFacts(name, "", (640, 480), at, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.0,) * 3, (0.0,) * 3),),
        (LidarFacts(name, at, (9, 9, 9), (0.5, 0.5, 0.5), (3.0, 3.0, 3.0)),),
        (RadarFacts(name, at, (1, 0, 3)),),
        RtkFacts(name, at, ("fixed", "float", "other"), (0.01, 0.5, 2.0)),
    )
    quality = Quality(41, (Deduction("QLT-601", 59, name),), facts, (Finding("MSG-301", "error", name, name),))
    topics = (InspectedTopic(Topic(name, name, 3, ""), "camera", measure(recordings.ticks(0.3, 10), True)),)
    clocks = ClockReport(
        (TopicClock(name, "camera", 3, 10.0, "sensor", 18 * S, 1.5, 0.1, 20_000, "GPS − UTC"),),
        ImuLag(name, name, 12_000_000, 100_000, 0.99),
    )
    inspection = Inspection(2 * S, topics, (Finding("TIM-202", "warning", name, name),), clocks)
    pictures = [("track.png", "image/png", b"\x89PNG"), (name, "image/png", b"")]
    return quality_page(name, inspection, quality, pictures).decode()


@pytest.fixture(scope="module")
def page() -> str:
    return hostile_page()


@pytest.fixture(scope="module")
def document(page: str) -> Document:
    return Document(page)


def test_every_tag_is_closed_identifiers_are_unique_and_links_lead_to_them(document: Document) -> None:
    assert (document.faults, document.open) == ([], [])
    identifiers = Counter(attributes["id"] for _, attributes in document.elements if "id" in attributes)
    assert max(identifiers.values()) == 1
    targets = {(attributes["href"] or "")[1:] for attributes in document.of("a")}
    assert targets <= set(identifiers)
    used = {(attributes["xlink:href"] or "")[1:] for attributes in document.of("use")}
    assert used <= set(identifiers)


def test_hostile_names_are_text_and_nothing_is_fetched(page: str, document: Document) -> None:
    tags = {tag for tag, _ in document.elements}
    assert not tags & {"script", "iframe", "object", "embed", "link", "form", "base"}
    assert not [name for _, attributes in document.elements for name in attributes if name.startswith("on")]
    assert "\x1b" not in page
    assert "\u202e" not in page
    assert "<script>alert(1)</script>" in "".join(document.words)
    sources = [attributes[name] or "" for _, attributes in document.elements for name in ("src", "href", "xlink:href")
               if attributes.get(name)]  # fmt: skip
    assert sources
    assert all(source.startswith(("#", "data:image/")) for source in sources)
    (policy,) = (meta["content"] for meta in document.of("meta") if meta.get("http-equiv"))
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "@import" not in page
    assert "url(http" not in page


def test_a_code_leads_to_what_it_means_and_the_findings_with_most_harm_come_first() -> None:
    findings = (Finding("TIM-201", "warning", "/ins", "host"), Finding("TIM-202", "warning", "/radar", "37 s"))
    quality = Quality(90, (Deduction("QLT-602", 5, "blurred"),), Facts(), (Finding("XYZ-999", "info", "", "new"),))
    page = quality_page("run.mcap", Inspection(S, (), findings), quality).decode()
    document = Document(page)
    assert {"#code-TIM-201", "#code-TIM-202"} <= {attributes["href"] for attributes in document.of("a")}
    assert {attributes.get("id") for attributes in document.of("dt")} == {
        "code-QLT-602",
        "code-TIM-201",
        "code-TIM-202",
    }
    assert page.index("(labels may be wrong)") < page.index("(labels unaffected)")
    for code in ("QLT-602", "TIM-201", "TIM-202"):
        assert CATALOGUE[code].remedy.replace("'", "&#39;") in page


def test_every_picture_says_in_words_what_it_shows_and_tables_are_headed(document: Document) -> None:
    plots = [attributes for tag, attributes in document.elements if attributes.get("role") == "img"]
    assert len(plots) >= 8
    assert all(attributes.get("aria-label") for attributes in plots)
    assert len(document.of("figure")) == len(document.of("figcaption"))
    assert all(attributes.get("aria-hidden") == "true" for attributes in document.of("svg"))
    assert all(attributes.get("alt") == "" for attributes in document.of("img"))  # the figure around it speaks
    boxes = [attributes for attributes in document.of("div") if attributes.get("class") == "scroll"]
    assert len(boxes) >= 5
    assert all(box.get("tabindex") == "0" and box.get("role") == "region" and box.get("aria-label") for box in boxes)
    assert len(document.of("table")) == len(document.of("caption"))
    assert {attributes.get("scope") for attributes in document.of("th")} == {"col", "row"}


def test_a_page_of_nothing_is_a_page() -> None:
    nothing = quality_page("empty.mcap", Inspection(0, (), ()), Quality(100, (), Facts(), ())).decode()
    document = Document(nothing)
    assert (document.faults, document.open) == ([], [])
    assert "None: full score." in nothing


def test_a_page_of_thousands_of_topics_and_findings_is_bounded() -> None:
    topics = [Coverage(f"/t{number}", "other", 3, 10.0, 0, S, 1.0, (1.0,), (10.0,)) for number in range(100)]
    findings = tuple(Finding("TIM-204", "warning", f"/t{number}" * 999, "x" * 5000) for number in range(3000))
    inspected = tuple(
        InspectedTopic(Topic(f"/t{number}", "a/msg/B", 3, ""), "other", measure(ticks(0.3, 10), False))
        for number in range(3000)
    )
    quality = Quality(0, (), Facts(0, tuple(topics)), ())
    page = quality_page("many.mcap", Inspection(S, inspected, findings), quality)
    assert len(page) < 500_000
    assert "2900 topics more" in page.decode()
    assert "and 2800 more" in page.decode()


def test_the_page_of_a_real_recording_shows_what_was_measured(tmp_path: Path) -> None:
    stamps = ticks(3, 10)
    path = written(
        tmp_path / "run.mcap",
        recordings.clouds(stamps),
        recordings.solutions(ticks(3, 20), 55),
        recordings.pictures("/camera/front/image", stamps),
    )
    inspection, quality = measured(path)
    document = Document(quality_page(path.name, inspection, quality).decode())
    words = " ".join(document.words)
    assert (document.faults, document.open) == ([], [])
    for topic in inspection.topics:
        assert topic.topic.name in words
    for deduction in quality.deductions:
        assert deduction.code in words
    assert f"{quality.score}" in words
    assert "75.0 %" in words  # of the points returned


@given(words=st.text())
def test_a_text_is_one_printable_line_of_bounded_length(words: str) -> None:
    shown = plain(words, 40)
    assert shown.isprintable()
    assert len(shown) <= 41 * 10
    assert "<" not in text(words)
    assert '"' not in text(words)


PHONE_PX, LEAST_TEXT_PX = 360, 9
MEASURE = """<!doctype html><iframe id="f" src="page.html" style="width:%dpx;height:800px;border:0"></iframe>
<script>
f.onload = () => {
  const page = f.contentDocument, told = { plots: 0 };
  told.wide = [...page.querySelectorAll("body *")].filter(one => !one.closest(".scroll") && !one.closest("svg")
    && one.getBoundingClientRect().right > %d + 1).map(one => one.tagName + "." + one.className);
  const texts = [...page.querySelectorAll(".plot svg:not(.strip) text")];
  told.plots = texts.length;
  told.smallest_px = Math.min(...texts.map(one => one.getBoundingClientRect().height));
  told.background = getComputedStyle(page.body).backgroundColor;
  told.bar = getComputedStyle(page.querySelector("rect.cover")).fill;
  told.line = getComputedStyle(page.querySelector(".plot svg:not(.strip) path[style*=stroke]")).stroke;
  document.body.textContent = "TOLD" + JSON.stringify(told) + "END";
};
</script>"""


@pytest.fixture(scope="module")
def chromium() -> str:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium on PATH; install the system's chromium to see the page in it")
    return program


@pytest.mark.whole
def test_the_page_fits_a_phone_and_wears_its_own_style(chromium: str, tmp_path: Path) -> None:
    """Catches alone a report that a browser shows other than it was written."""
    (tmp_path / "page.html").write_text(hostile_page("/camera/front_right/image/compressed" * 2), "utf-8")
    (tmp_path / "measure.html").write_text(MEASURE % (PHONE_PX, PHONE_PX), "utf-8")
    command = [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=8000", "--dump-dom"]
    run = subprocess.run([*command, (tmp_path / "measure.html").as_uri()], capture_output=True, timeout=300, check=True)
    said = re.search(r"TOLD(\{.*\})END", run.stdout.decode())
    assert said is not None, run.stdout[-2000:]
    told = json.loads(said[1])
    assert told["wide"] == []
    assert told["plots"] > 30
    assert told["smallest_px"] >= LEAST_TEXT_PX
    assert told["background"] in ("rgb(244, 245, 240)", "rgb(20, 23, 15)")
    assert told["bar"] in ("rgb(46, 125, 70)", "rgb(110, 203, 135)")
    assert told["line"].startswith("rgb(")
