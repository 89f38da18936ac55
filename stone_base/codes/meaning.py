"""The meaning of a code, and how much what it reports harms the labels.

**Conventions.** Severity is of one finding, harm of its code: `TIM-201` and `LAB-603` are both warnings, of which the
first changes no label. What harm a code does may differ where it is an error, or only a warning; a finding of severity
`info` does none.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Harm = Literal["none", "less", "wrong", "refused"]
HARM_ORDER: tuple[Harm, ...] = ("refused", "wrong", "less", "none")
HARM_WORDS: Mapping[Harm, str] = {
    "none": "labels unaffected",
    "less": "some data is missing",
    "wrong": "labels may be wrong",
    "refused": "no labels",
}
HARM_SENTENCES: Mapping[Harm, str] = {
    "none": "No. The labels are the same as without this finding.",
    "less": "Partly. Messages, frames, masks or the data of a sensor are left out. The other labels are unaffected.",
    "wrong": "Possibly. Labels are made, but some may be wrong: check them before you use them.",
    "refused": "Yes. The input or the run is refused, so there are no labels until you solve the problem.",
}


@dataclass(frozen=True)
class CodeMeaning:
    """What `code` means and what to do, in full sentences; `as_error`, `as_warning`: the harm where it differs."""

    code: str
    harm: Harm
    meaning: str
    remedy: str
    as_error: Harm | None = None
    as_warning: Harm | None = None

    def harm_as(self, severity: str) -> Harm:
        """The harm of a finding of this code and `severity`."""
        if severity == "info":
            return "none"
        return {"error": self.as_error, "warning": self.as_warning}.get(severity) or self.harm

    @property
    def differing(self) -> Mapping[str, Harm]:
        """The harm by severity, of those severities that do another one."""
        return {word: harm for word in ("warning", "error") if (harm := self.harm_as(word)) != self.harm}
