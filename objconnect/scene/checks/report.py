"""The result of a validation, for a person and for a program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes:
        name: name of the check.
        ok: whether it passed.
        detail: one line: what was measured and, if wrong, what it means.
        figures: the numbers behind it.
    """

    name: str
    ok: bool
    detail: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """The results of all checks of one subject.

    Attributes:
        subject: what was checked.
        checks: results.
    """

    subject: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Return whether every check passed."""
        return all(check.ok for check in self.checks)

    def text(self) -> str:
        """Return one line per check, then the verdict."""
        width = max((len(check.name) for check in self.checks), default=0)
        lines = [
            f"{'ok   ' if check.ok else 'WRONG'} {check.name:<{width}}  {check.detail}"
            for check in self.checks
        ]
        wrong = sum(not check.ok for check in self.checks)
        verdict = f"{wrong} of {len(self.checks)} checks failed" if wrong else "all checks hold"
        return "\n".join([*lines, f"{self.subject}: {verdict}"])

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data for a program."""
        checks = [
            {"name": c.name, "ok": c.ok, "detail": c.detail, "figures": c.figures}
            for c in self.checks
        ]
        return {"subject": self.subject, "ok": self.ok, "checks": checks}
