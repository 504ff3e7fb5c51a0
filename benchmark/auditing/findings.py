"""The verdicts of an audit, for a person and for a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """The verdict of an audit on one property of a data set."""

    RIGHT = "right"
    WRONG = "wrong"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Finding:
    """The verdict of one check.

    Attributes:
        check: the checked property.
        verdict: the verdict.
        detail: one line: the measurement and, if wrong, the likely fault; if unknown, the reason.
        fault: short name of the fault for programs, such as ``poses-inverted``; empty unless the
            verdict is wrong.
        figures: the measured numbers.
    """

    check: str
    verdict: Verdict
    detail: str
    fault: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


def right(check: str, detail: str, **figures: float) -> Finding:
    """Return the finding that a property is right."""
    return Finding(check, Verdict.RIGHT, detail, figures=figures)


def wrong(check: str, fault: str, detail: str, **figures: float) -> Finding:
    """Return the finding that a property is wrong, with the short name of its fault."""
    return Finding(check, Verdict.WRONG, detail, fault, figures)


def unknown(check: str, why: str, **figures: float) -> Finding:
    """Return the finding that a property could not be checked."""
    return Finding(check, Verdict.UNKNOWN, why, figures=figures)


@dataclass(frozen=True)
class Audit:
    """The verdicts on one data set.

    Attributes:
        subject: the data set.
        kind: its format.
        photographs: number of photographs that it lists.
        findings: one for each check.
        stated_and_measured_xy: stated east and north, then measured east and north (m) of each
            photograph with GPS; empty without GPS.
    """

    subject: str
    kind: str
    photographs: int
    findings: tuple[Finding, ...]
    stated_and_measured_xy: tuple[tuple[float, ...], ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong; a property that could not be checked is not wrong."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """The short names of all faults."""
        return tuple(f.fault for f in self.findings if f.verdict is Verdict.WRONG)

    def text(self) -> str:
        """Return one line for each check, then the verdict."""
        width = max((len(finding.check) for finding in self.findings), default=0)
        lines = [
            f"{_MARKS[finding.verdict]} {finding.check:<{width}}  {finding.detail}"
            for finding in self.findings
        ]
        return "\n".join([*lines, f"{self.subject} ({self.kind}): {self.count_verdicts()}"])

    def count_verdicts(self) -> str:
        """Return the number of checks with each verdict, in words."""
        count = {v: sum(f.verdict is v for f in self.findings) for v in Verdict}
        parts = [f"{count[Verdict.WRONG]} wrong", f"{count[Verdict.RIGHT]} right"]
        return ", ".join([*parts, f"{count[Verdict.UNKNOWN]} unknown"])

    def as_dict(self) -> dict[str, Any]:
        """Return the audit as plain data for a program."""
        findings = [
            {
                "check": f.check,
                "verdict": f.verdict.value,
                "fault": f.fault,
                "detail": f.detail,
                "figures": dict(f.figures),
            }
            for f in self.findings
        ]
        return {
            "subject": self.subject,
            "kind": self.kind,
            "photographs": self.photographs,
            "ok": self.ok,
            "findings": findings,
        }


_MARKS = {Verdict.RIGHT: "ok   ", Verdict.WRONG: "WRONG", Verdict.UNKNOWN: "?    "}
