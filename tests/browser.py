"""A real headless Chromium for tests, driven through its debugging pipe.

``python -m tests.browser`` checks that Chromium is installed. As root with apt it installs it;
otherwise it prints the command that does. Protocol: https://chromedevtools.github.io/devtools-protocol
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

from objconnect.scene.runtime.debian import check, require_packages

_NAMES = ("chromium", "chromium-browser", "google-chrome")
# Without a font a browser draws no text at all.
_FONTS = Path("/usr/share/fonts")
_TIMEOUT_S = 300.0
# Chromium listens on descriptor 3 and answers on 4.
_EXEC = (
    "import fcntl, os, sys\n"
    "ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]\n"
    "os.dup2(ends[0], 3), os.dup2(ends[1], 4)\n"
    "os.execv(sys.argv[3], sys.argv[3:])\n"
)


def missing_packages() -> list[str]:
    """Return the missing Debian packages of the browser and of a font."""
    missing = [] if _executable() else ["chromium"]
    return missing if any(_FONTS.rglob("*.[to]tf")) else [*missing, "fonts-dejavu-core"]


def _executable() -> str | None:
    return next((path for name in _NAMES if (path := shutil.which(name))), None)


def require_browser(install: bool = False) -> str:
    """Return the path of the browser's executable.

    Raises:
        InputError: there is none; the message holds the line that installs it.
    """
    require_packages(missing_packages, "tests of the page need a browser, which is", install)
    return _executable() or ""


class Browser:
    """One page of one Chromium. Use as a context manager.

    Attributes:
        errors: what the console, the log and uncaught exceptions complained about.
        requests: addresses the page asked for.
    """

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._number = 0
        self._loaded: set[str] = set()  # names that the browser gives to loads
        self._rest = b""
        self._session: str | None = None

    def __enter__(self) -> Browser:
        self._folder = TemporaryDirectory(prefix="browser-")
        command = [require_browser(), "--headless=new", "--remote-debugging-pipe", "--no-first-run"]
        command += ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"]
        command += ["--disable-background-networking", "--disable-component-update"]
        command += [f"--user-data-dir={self._folder.name}"]
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        wrapper = [sys.executable, "-c", _EXEC, str(theirs_in), str(theirs_out)]
        self._process = subprocess.Popen(
            [*wrapper, *command],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "HOME": self._folder.name},
        )
        os.close(theirs_in)
        os.close(theirs_out)
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        self.send("Page.setLifecycleEventsEnabled", enabled=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._to)  # a browser without its pipe ends
        os.close(self._from)
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        # The last of its processes may still be writing into its profile.
        shutil.rmtree(self._folder.name, ignore_errors=True)
        self._folder.cleanup()

    def open(self, path: Path, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Open a file at a size of window, narrow ones as a phone; forget what was said before."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[scheme])
        self.errors.clear()
        self.requests.clear()
        load = self.send("Page.navigate", url=path.resolve().as_uri())["loaderId"]
        self._wait_for_load(lambda: load in self._loaded)

    def reload(self) -> None:
        """Load the page again at the address it has now."""
        before = set(self._loaded)
        self.send("Page.reload")
        self._wait_for_load(lambda: self._loaded > before)

    def _wait_for_load(self, is_over: Callable[[], bool]) -> None:
        end = time.monotonic() + _TIMEOUT_S
        while not is_over():
            assert time.monotonic() < end, "the page did not load"
            self._note(self._read())
        self.settle()

    def settle(self) -> None:
        """Wait until what was laid out is painted."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def run(self, script: str) -> Any:
        """The value of an expression in the page.

        Raises:
            AssertionError: it threw.
        """
        answer = self.send(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, script: str) -> None:
        """Wait until an expression is true.

        Raises:
            AssertionError: it never was.
        """
        end = time.monotonic() + _TIMEOUT_S
        while not self.run(script):
            assert time.monotonic() < end, f"never true: {script}"
            time.sleep(0.02)

    def texts(self, selector: str) -> list[str]:
        """What the matching elements say, as a reader sees it."""
        found = f"document.querySelectorAll({json.dumps(selector)})"
        texts: list[str] = self.run(f"[...{found}].map(e => e.innerText.trim())")
        return texts

    def click(self, selector: str) -> None:
        """Click with the mouse in the middle of the first match, as far as it is to be seen.

        Raises:
            AssertionError: nothing matches, or something else lies above it.
        """
        x, y, hit = self.run(
            f"""(() => {{
            const e = document.querySelector({json.dumps(selector)});
            e.scrollIntoView({{ block: "center", inline: "center", behavior: "instant" }});
            const r = e.getBoundingClientRect(), x = r.x + r.width / 2, y = r.y + r.height / 2;
            const top = document.elementFromPoint(x, y);
            return [x, y, top !== null && (e.contains(top) || top.contains(e))];
        }})()"""
        )
        assert hit, f"{selector} is covered"
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        self.settle()

    def press(self, key: str) -> None:
        """Press a key: "Enter", "Tab" or a letter."""
        text = {"Enter": "\r", "Tab": "\t"}.get(key, key)
        code = {"Enter": 13, "Tab": 9}.get(key, 0)
        for kind in ("keyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent", type=kind, key=key, text=text, windowsVirtualKeyCode=code
            )
        self.settle()

    def screenshot(self, path: Path, whole: bool = True) -> None:
        """PNG of the window, or of the whole page."""
        screenshot = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(screenshot["data"]))

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol, and its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._to, data) :]
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _note(self, message: dict[str, Any]) -> None:
        event, params = message.get("method"), message.get("params", {})
        if event == "Page.lifecycleEvent" and params["name"] == "load":
            self._loaded.add(params["loaderId"])
        elif event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(params["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
            self.errors.append(json.dumps(params["args"]))
        elif event == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.errors.append(json.dumps(params["entry"]))
        elif event == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._from], [], [], _TIMEOUT_S)
            assert ready, "the browser does not answer"
            part = os.read(self._from, 1 << 20)
            assert part, "the browser has ended"
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        answer: dict[str, Any] = json.loads(message)
        return answer


if __name__ == "__main__":
    sys.exit(check(lambda: require_browser(install=True)))
