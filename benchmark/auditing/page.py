"""The verdicts of audits as one HTML page that needs no network and no server."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.auditing.findings import Audit, Verdict
from benchmark.report.self_contained import fill
from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.outputs import OutputFile, check_outputs

ENDINGS: Final = (".html", ".htm")
# Bytes near the beginning of every page, by which an earlier page is recognized and replaced.
_MARK = b"<title>ObjConnect audit</title>"
_KINDS: Final = {Verdict.RIGHT: "right", Verdict.WRONG: "wrong", Verdict.UNKNOWN: "unknown"}


def check_page(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse a page that cannot be written.

    Raises:
        InputError: the name ends in neither .html nor .htm, or ``check_outputs`` refuses the file.
    """
    if out.suffix.lower() not in ENDINGS:
        raise InputError(f"{out} must end in .html: the page of an audit is HTML")
    check_outputs([OutputFile(out, _MARK)], inputs)


def write_page(audits: Sequence[Audit], out: Path) -> None:
    """Write the page.

    Raises:
        WriteError: the folder cannot be written.
    """
    write_text(out, fill("audit", {"audits": [_to_content(audit) for audit in audits]}))


def _to_content(audit: Audit) -> dict[str, Any]:
    findings = [
        {"check": f.check, "kind": _KINDS[f.verdict], "detail": f.detail, "fault": f.fault}
        for f in audit.findings
    ]
    plan = [
        [round(value, 2) for value in row]
        for row in audit.stated_and_measured_xy
        if all(math.isfinite(value) for value in row)
    ]
    return {
        "subject": audit.subject,
        "kind": audit.kind,
        "photographs": audit.photographs,
        "findings": findings,
        "plan": plan,
    }
