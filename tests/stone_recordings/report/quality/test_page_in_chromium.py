"""The page in a real browser: it fits a phone, its plots have legible text, and its policy blocks nothing of its own.

**Conventions.** Chromium without a window, driven by its command line alone: a page of ours holds the report in a frame
of a phone's width, measures it, and is printed. Skipped with a reason where there is no Chromium.
"""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.stone_recordings.report.quality.test_page import hostile_page

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
