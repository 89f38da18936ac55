"""The overview of the page: the score and its verdict, the pictures, and the findings.

**Conventions.** The words for a score follow the thresholds in `VERDICTS`.
"""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence

from markupsafe import Markup

from stone.findings import Finding
from stone_base.codes.catalogue import CATALOGUE, harm_rank
from stone_base.codes.meaning import CodeMeaning
from stone_recordings.report.quality.markup import DrawnFigure
from stone_recordings.report.quality.score import Deduction

# From this score on: the class of the ring, and the word.
VERDICTS = (
    (90, "good", "Good"),
    (70, "usable", "Usable: see the deductions"),
    (0, "poor", "Poor: labels will be affected"),
)
WIDE = "cameras.jpg"
TOLD = {
    WIDE: ("Camera images", "One image of each camera from the middle of the recording."),
    "sweep.png": ("One sweep from above", "The LiDAR's sweep in the middle of the recording, coloured by height."),
    "track.png": ("Track", "The recording's own positions, seen from above."),
}
Picture = tuple[str, str, bytes]


def verdict_of(score: int) -> tuple[str, str]:
    """Return the class of the ring, and the word."""
    return next((tone, word) for least, tone, word in VERDICTS if score >= least)


def pictures_section(pictures: Sequence[Picture]) -> dict[str, list[DrawnFigure]]:
    """Return the previews of the recording: those over the page's whole width, and the others."""
    shown = {"wide": list(_figures(pictures, is_wide=True)), "others": list(_figures(pictures, is_wide=False))}
    return shown if any(shown.values()) else {}


def ordered(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings with the most harm to labels first; for equal harm errors first."""
    return sorted(findings, key=lambda finding: harm_rank(finding.code, finding.severity))


def codes_section(findings: Iterable[Finding], deductions: Iterable[Deduction]) -> list[CodeMeaning]:
    """Return the meaning of each code of these findings and deductions, once, in order of code."""
    codes = {finding.code for finding in findings} | {deduction.code for deduction in deductions}
    return [CATALOGUE[code] for code in sorted(codes) if code in CATALOGUE]


def _figures(pictures: Sequence[Picture], *, is_wide: bool) -> Iterator[DrawnFigure]:
    for file_name, media_type, content in pictures:
        if file_name in TOLD and (file_name == WIDE) == is_wide:
            title, caption = TOLD[file_name]
            source = f"data:{media_type};base64,{b64encode(content).decode()}"
            yield DrawnFigure(title, Markup('<img src="{}" alt="">').format(source), caption)
