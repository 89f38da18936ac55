"""The page's first words: the score, what it lost and by what, the pictures, and the findings.

**Conventions.** HTML through `markup`; the words for a score are as the thresholds in `VERDICTS` say.
"""

from base64 import b64encode
from collections.abc import Iterator, Sequence

from services.ingest.quality.markup import figure, name, section, text
from services.ingest.quality.report import Quality
from services.ingest.quality.score import FULL_SCORE
from stone.findings import Finding

# From this score on: the class of the ring, and the word.
VERDICTS = (
    (90, "good", "Good"),
    (70, "usable", "Usable: look at what it lost"),
    (0, "poor", "Poor: labels will suffer"),
)
MOST_FINDINGS = 200
SEVERITIES = ("error", "warning", "info")
TOLD = {
    "cameras.jpg": ("What the cameras saw", "One picture of each camera from the middle of the recording."),
    "sweep.png": ("One sweep from above", "The LiDAR's sweep in the middle of the recording, coloured by height."),
    "track.png": ("Where the robot went", "The track of the recording's own positions, seen from above."),
}
Picture = tuple[str, str, bytes]


def ring(score: int) -> str:
    """The score as a ring, with its word."""
    tone, word = next((tone, word) for least, tone, word in VERDICTS if score >= least)
    inside = f"<div><b>{score}</b><span>of {FULL_SCORE}</span></div>"
    return (
        f'<div class="ring {tone}" style="--score:{score}" role="img" aria-label="Quality {score} of {FULL_SCORE}">'
        f'{inside}</div><p class="verdict {tone}">{text(word)}</p>'
    )


def lost_section(quality: Quality) -> str:
    listed = "".join(
        f'<li><b>−{one.points}</b><span><span class="code">{text(one.code)}</span> {text(one.message)}</span></li>'
        for one in quality.deductions
    )
    told = f'<ol class="lost">{listed}</ol>' if listed else "<p>Nothing: the full score.</p>"
    return section("lost", "What the score lost", [told])


def pictures_section(pictures: Sequence[Picture]) -> str:
    """The previews of the recording, inside the page."""
    return section("pictures", "At a glance", _pictures(pictures))


def findings_section(findings: Sequence[Finding]) -> str:
    """Errors first, each as the command line says it."""
    ordered = sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))
    listed = "".join(_finding(finding) for finding in ordered[:MOST_FINDINGS])
    rest = len(ordered) - MOST_FINDINGS
    more = f"<p>… and {rest} more.</p>" if rest > 0 else ""
    told = f'<ul class="findings">{listed}</ul>{more}' if listed else "<p>Nothing was noticed.</p>"
    return section("findings", "Findings", [told])


def _pictures(pictures: Sequence[Picture]) -> Iterator[str]:
    shown = [picture for picture in pictures if picture[0] in TOLD]
    wide = [picture for picture in shown if picture[0] == "cameras.jpg"]
    yield from (_picture(picture) for picture in wide)
    if others := [picture for picture in shown if picture not in wide]:
        yield f'<div class="grid">{"".join(_picture(picture) for picture in others)}</div>'


def _picture(picture: Picture) -> str:
    file_name, media_type, content = picture
    title, told = TOLD[file_name]
    source = f"data:{media_type};base64,{b64encode(content).decode()}"
    return figure(title, f'<img src="{source}" alt="">', told)


def _finding(finding: Finding) -> str:
    about = f"{name(finding.topic)} " if finding.topic else ""
    badge = f'<span class="sev {finding.severity}">{finding.severity}</span>'
    return f'<li>{badge} <span class="code">{text(finding.code)}</span> {about}{text(finding.message)}</li>'
