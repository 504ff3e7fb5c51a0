"""A stand-in for the Hugging Face hub on this machine: one name, its commits and uploads.

The name is that of a data set and of a model, which share their commits.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

REPOSITORY = "owner/fields"


@dataclass
class Hub:
    """The repository.

    Attributes:
        url: address of the server.
        commits: bytes of the files by path, by commit.
        requests: paths that were asked for.
    """

    url: str
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    requests: list[str] = field(default_factory=list)

    def commit(self, files: dict[str, bytes]) -> str:
        """Add a commit and return its name."""
        name = hashlib.sha1("".join(sorted(files)).encode()).hexdigest()
        self.commits[name] = files
        return name

    def commit_folder(self, folder: Path) -> str:
        """Add the files of a folder as a commit and return its name."""
        files = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return self.commit({p.relative_to(folder).as_posix(): p.read_bytes() for p in files})


@contextmanager
def hub_server() -> Iterator[Hub]:
    """Run the stand-in during the block."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    server.hub = Hub(f"http://127.0.0.1:{server.server_port}")  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server.hub  # type: ignore[attr-defined]
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    @property
    def hub(self) -> Hub:
        return self.server.hub  # type: ignore[attr-defined, no-any-return]

    def log_message(self, *_: object) -> None:
        """Print nothing."""

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.hub.requests.append(path)
        tree = re.match(rf"/api/(?:datasets|models)/{REPOSITORY}/tree/(.+)", path)
        file = re.match(rf"(?:/datasets)?/{REPOSITORY}/resolve/([^/]+)/(.+)", path)
        if tree is not None:
            commit = tree[1]
            if commit not in self.hub.commits:
                return self._fail("RevisionNotFound")
            return self._send_json([_entry(*file) for file in self.hub.commits[commit].items()])
        if file is not None:
            commit, name = file.groups()
            if commit not in self.hub.commits:
                return self._fail("RevisionNotFound")
            content = self.hub.commits[commit][name]
            return self._send(content, {"X-Repo-Commit": commit, "ETag": f'"{_blob(content)}"'})
        return self._fail("RepoNotFound")

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path = urlsplit(self.path).path
        self.hub.requests.append(path)
        if path == "/api/repos/create":
            return self._send_json({"url": f"{self.hub.url}/datasets/{REPOSITORY}"})
        if re.fullmatch(rf"/api/(datasets|models)/{REPOSITORY}/preupload/main", path):
            files = [each["path"] for each in json.loads(body)["files"]]
            modes = [
                {"path": name, "uploadMode": "regular", "shouldIgnore": False} for name in files
            ]
            return self._send_json({"files": modes})
        if re.fullmatch(rf"/api/(datasets|models)/{REPOSITORY}/commit/main", path):
            lines = [json.loads(line) for line in body.splitlines()]
            added = [line["value"] for line in lines if line["key"] == "file"]
            commit = self.hub.commit({a["path"]: base64.b64decode(a["content"]) for a in added})
            url = f"{self.hub.url}/datasets/{REPOSITORY}/commit/{commit}"
            return self._send_json({"success": True, "commitOid": commit, "commitUrl": url})
        if path == "/api/validate-yaml":
            return self._send_json({"errors": [], "warnings": []})
        return self._fail("RepoNotFound")

    def _fail(self, code: str) -> None:
        self._send(b"{}", {"X-Error-Code": code}, 404)

    def _send_json(self, value: Any) -> None:
        self._send(json.dumps(value).encode(), {"Content-Type": "application/json"})

    def _send(self, content: bytes, headers: dict[str, str], status: int = 200) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


def _entry(name: str, content: bytes) -> dict[str, Any]:
    return {"type": "file", "path": name, "size": len(content), "oid": _blob(content)}


def _blob(content: bytes) -> str:
    """Return the name that git gives to a file's content."""
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
