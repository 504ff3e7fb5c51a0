"""Folders that the same command goes on with after a stop."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.storage.resumable import ResumableFolder


def folder(path: Path, request: str, record: str = "record.txt") -> ResumableFolder:
    def difference(recorded: Path) -> str | None:
        return None if recorded.read_text() == request else "colour"

    return ResumableFolder(path, path / record, request, difference)


def refusal(difference: str) -> str:
    return f"another {difference} {{}}"


def test_the_same_request_goes_on_and_another_is_refused(tmp_path: Path) -> None:
    red = folder(tmp_path, "red")
    assert not red.can_resume(refusal)
    red.begin()
    assert red.is_begun()
    assert red.has_same_request()
    assert red.can_resume(refusal)
    blue = folder(tmp_path, "blue")
    assert not blue.has_same_request()
    with pytest.raises(InputError, match="another colour {}"):
        blue.can_resume(refusal)
    red.end()
    red.end()
    assert not blue.can_resume(refusal)
    assert list(tmp_path.iterdir()) == []


def test_a_hidden_folder_of_intermediate_results_goes_with_its_record(tmp_path: Path) -> None:
    hidden = folder(tmp_path, "red", ".objconnect-work/record.txt")
    hidden.begin()
    (tmp_path / ".objconnect-work" / "half").write_text("half")
    (tmp_path / "whole").write_text("whole")
    hidden.end()
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


def test_files_of_others_are_not_begun_among(tmp_path: Path) -> None:
    wanted = folder(tmp_path, "red")
    (tmp_path / ".objconnect-abcd1234.partial").write_text("half")
    wanted.require_empty("scene")
    wanted.begin()
    assert [path.name for path in tmp_path.iterdir()] == ["record.txt"]
    wanted.end()
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(InputError, match="is not empty and not a scene: choose another folder"):
        wanted.require_empty("scene")
    with pytest.raises(InputError, match="cannot use .* for a scene"):
        folder(tmp_path / "mine", "red").require_empty("scene")
