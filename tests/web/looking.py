"""A page as people look at it: light, dark, at phone width; by axe; by screenshots that are kept.

**Conventions.** `look(page, "leaderboard")` fails where axe finds something serious, or where the page is wider than
the phone. All of axe's rules are asked of the light page at both widths; of the dark one those of colours, for it
differs by tokens only. A run in one process keeps screenshots: `build/screenshots/<name>-<light|dark|phone>.png`. A run
in several keeps none, for nobody looks at them, and they cost a quarter of the look.
"""

import os
from functools import cache
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from testing.web.browsing import DESKTOP, PHONE

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "build" / "screenshots"
AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
SERIOUS = ("serious", "critical")
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
EVERY_RULE: dict[str, Any] = {"runOnly": {"type": "tag", "values": RULES}}
RULES_OF_COLOUR: dict[str, Any] = {"runOnly": {"type": "rule", "values": ["color-contrast", "link-in-text-block"]}}
LOOKS = (
    ("light", "light", DESKTOP, EVERY_RULE),
    ("dark", "dark", DESKTOP, RULES_OF_COLOUR),
    ("phone", "light", PHONE, EVERY_RULE),
)


def look(page: Page, name: str) -> None:
    """Look at the page in every way people do. The page is left light, at desktop width."""
    for kind, scheme, size, rules in LOOKS:
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        page.set_viewport_size(size)  # type: ignore[arg-type]
        assert serious_findings(page, rules) == [], f"{name}, {kind}"
        overflow_px = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert overflow_px <= 0, f"{name}, {kind}: {overflow_px} px wider than the window"
        keep(page, f"{name}-{kind}")
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(DESKTOP)  # type: ignore[arg-type]


def keep(page: Page, name: str) -> None:
    """Keep a picture of the whole page, if this is a run in one process."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        return
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}.png", full_page=True)


def serious_findings(page: Page, rules: dict[str, Any] = EVERY_RULE) -> list[str]:
    """What axe finds serious: the rule and the first elements."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(_axe())
    options = {**rules, "resultTypes": ["violations"]}
    found: list[dict[str, Any]] = page.evaluate(
        "options => axe.run(document, options).then(r => r.violations)", options
    )
    return [
        f"{one['id']}: {one['help']}: {[node['html'][:120] for node in one['nodes'][:3]]}"
        for one in found
        if one["impact"] in SERIOUS
    ]


@cache
def _axe() -> str:
    return AXE.read_text("utf-8")
