"""Findings of a validation, for a person and for a program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        name: of the check.
        ok: whether it holds.
        detail: one line: what was found and, when wrong, what it means.
        figures: numbers behind it.
    """

    name: str
    ok: bool
    detail: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """Everything looked at in one place."""

    subject: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every check holds."""
        return all(check.ok for check in self.checks)

    def text(self) -> str:
        """One line per check, then the verdict."""
        width = max((len(check.name) for check in self.checks), default=0)
        lines = [
            f"{'ok   ' if check.ok else 'WRONG'} {check.name:<{width}}  {check.detail}"
            for check in self.checks
        ]
        wrong = sum(not check.ok for check in self.checks)
        verdict = f"{wrong} of {len(self.checks)} checks failed" if wrong else "all checks hold"
        return "\n".join([*lines, f"{self.subject}: {verdict}"])

    def as_dict(self) -> dict[str, Any]:
        """The same for a program."""
        checks = [
            {"name": c.name, "ok": c.ok, "detail": c.detail, "figures": c.figures}
            for c in self.checks
        ]
        return {"subject": self.subject, "ok": self.ok, "checks": checks}
