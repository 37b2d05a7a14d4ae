"""The answer to one question about a recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["good", "unknown", "warning"]


@dataclass(frozen=True)
class Finding:
    """The answer to one question about a recording.

    Attributes:
        question: short name of the question, such as "depth scale".
        severity: "warning" would spoil a run; "unknown" means that the data can't tell.
        message: one sentence with the value found, and the value expected where that is another.
        advice: one sentence that says what to change; "" if nothing.
        evidence: the measured numbers by name.
    """

    question: str
    severity: Severity
    message: str
    advice: str = ""
    evidence: Mapping[str, float | int] = field(default_factory=dict)
