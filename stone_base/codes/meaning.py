"""The meaning of a code, and its effect on labels.

**Conventions.** A finding has a severity, a code has a harm: `TIM-201` and `LAB-603` are both warnings, but `TIM-201`
changes no label. The harm of a code may differ between errors and warnings; a finding of severity `info` does none.
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
    """The meaning and the remedy of `code`, in full sentences.

    `as_error` and `as_warning` override `harm` for that severity.
    """

    code: str
    harm: Harm
    meaning: str
    remedy: str
    as_error: Harm | None = None
    as_warning: Harm | None = None

    def harm_as(self, severity: str) -> Harm:
        """Return the harm of a finding with this code and `severity`."""
        if severity == "info":
            return "none"
        return {"error": self.as_error, "warning": self.as_warning}.get(severity) or self.harm

    @property
    def differing(self) -> Mapping[str, Harm]:
        """The harm by severity, for the severities whose harm differs from `harm`."""
        return {word: harm for word in ("warning", "error") if (harm := self.harm_as(word)) != self.harm}
