"""``SHA256SUMS`` of a folder."""

from pathlib import Path

from objconnect.scene.storage.checksums import read_checksums, write_checksums
from objconnect.scene.storage.digests import sha256_of


def test_checksums_written_again_do_not_list_themselves(tmp_path: Path) -> None:
    file = tmp_path / "part" / "file.txt"
    file.parent.mkdir()
    file.write_text("text")
    for _ in range(2):
        write_checksums(tmp_path)
        assert read_checksums(tmp_path) == {"part/file.txt": sha256_of(file)}
