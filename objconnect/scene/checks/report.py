"""The result of a validation, as text and as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes:
        name: name of the check.
        ok: whether it passed.
        detail: one line: what was measured and, if it failed, what that means.
        figures: measured values by name.
    """

    name: str
    ok: bool
    detail: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """The results of all checks of one subject, such as the path of a scene."""

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
        """Return the report as plain data for JSON."""
        checks = [
            {"name": c.name, "ok": c.ok, "detail": c.detail, "figures": c.figures}
            for c in self.checks
        ]
        return {"subject": self.subject, "ok": self.ok, "checks": checks}
