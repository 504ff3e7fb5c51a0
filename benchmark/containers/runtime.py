"""Runs of container images by Docker, without a network and with limited resources."""

from __future__ import annotations

import os
import re
import subprocess
import uuid
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import IO, Final

from pydantic import Field

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.records import Record

DATA: Final = "/data"
"""Folder in the container that holds what ``benchmark.containers.data`` writes; read-only."""
OUTPUT: Final = "/output"
"""Folder in the container for ``poses.txt``."""

_DOCKER: Final = "docker"
# Names of images do not begin with a dash, so that none is taken for an option.
_IMAGE: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/:@-]{0,254}")
# Exit status of Docker if it could not start the container, and that of a killed container.
_NOT_STARTED: Final = 125
_KILLED: Final = 137
# Number of last bytes of a program's output that are kept, and of characters of a message.
_TAIL_BYTES: Final = 4096
_REASON_CHARACTERS: Final = 300
# Timeout of the commands that inspect an image or kill a container, seconds.
_TIMEOUT_S: Final = 60.0
# Most processes and threads in a container.
_MOST_PROCESSES: Final = 4096


class Limits(Record):
    """Limits on the resources of a container; they are not options of the method in it."""

    memory_gb: float = Field(16.0, ge=0.1, le=4096, description="Memory, 1e9 bytes.")
    cpus: float = Field(4.0, ge=0.1, le=1024, description="Number of processors.")
    minutes: float = Field(
        120.0, gt=0, le=100_000, description="Minutes after which the container is stopped."
    )


def require_image_name(image: str) -> None:
    """Refuse a word that is not the name of an image, such as an option of Docker.

    Raises:
        InputError: the word is not the name of an image.
    """
    if not _IMAGE.fullmatch(image):
        raise InputError(
            f"--container {image!r} is not the name of an image, such as example/method:1.0"
        )


def image_digest(image: str) -> str:
    """Return the digest of an image on this machine, ``sha256:...``.

    Raises:
        InputError: Docker is not installed or does not answer, or there is no such image.
    """
    command = [_DOCKER, "image", "inspect", "--format", "{{.Id}}", image]
    try:
        answer = subprocess.run(
            command, check=False, capture_output=True, timeout=_TIMEOUT_S, stdin=subprocess.DEVNULL
        )
    except FileNotFoundError:
        raise InputError(
            "the command docker was not found: containers need Docker, see "
            "https://docs.docker.com/engine/install"
        ) from None
    except OSError as error:
        raise InputError(f"the command docker cannot be run: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise InputError(f"docker did not answer in {_TIMEOUT_S:g} s: restart it") from None
    if answer.returncode:
        raise InputError(
            f"docker cannot use the image {image} ({_reason(answer.stderr)}): start its daemon, "
            "and build or pull the image"
        )
    return answer.stdout.decode(errors="replace").strip()


def run_container(digest: str, data: Path, output: Path, limits: Limits) -> None:
    """Run an image until it ends or its time is over.

    Args:
        digest: digest of the image, see ``image_digest``.
        data: folder that the container reads.
        output: folder that the container writes.
        limits: its limits.

    Raises:
        InputError: the container could not be started, failed, or took too long.
    """
    name = f"objconnect-{uuid.uuid4().hex}"
    command = docker_command(name, digest, data, output, limits)
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        assert process.stderr is not None
        tail = _Tail(process.stderr)
        try:
            code = process.wait(60 * limits.minutes)
        except subprocess.TimeoutExpired:
            _stop(name, process)
            raise InputError(
                f"the container was stopped after {limits.minutes:g} minutes: allow more with "
                "--set minutes=NUMBER"
            ) from None
        except BaseException:
            _stop(name, process)
            raise
        reason = _reason(tail.content())
    if code == _NOT_STARTED:
        raise InputError(f"docker could not start the container: {reason}")
    if code == _KILLED:
        raise InputError(
            f"the container was killed, as happens if it needs more than {limits.memory_gb:g} GB: "
            "allow more with --set memory_gb=NUMBER"
        )
    if code:
        raise InputError(f"the container ended with exit status {code}: {reason}")


def docker_command(name: str, digest: str, data: Path, output: Path, limits: Limits) -> list[str]:
    """Return the command that runs an image."""
    memory = f"{round(limits.memory_gb * 1e9)}b"
    return [
        *(_DOCKER, "run", "--rm", "--name", name, "--pull", "never"),
        *("--network", "none", "--read-only", "--tmpfs", "/tmp", "--env", "HOME=/tmp"),
        *("--cap-drop", "ALL", "--security-opt", "no-new-privileges"),
        *("--user", f"{os.getuid()}:{os.getgid()}", "--log-driver", "none"),
        *("--memory", memory, "--memory-swap", memory, "--cpus", f"{limits.cpus:g}"),
        *("--pids-limit", str(_MOST_PROCESSES)),
        *("--mount", _mount(data, DATA, "readonly"), "--mount", _mount(output, OUTPUT)),
        digest,
    ]


def _mount(source: Path, target: str, *others: str) -> str:
    """Return the value of ``--mount``: a line of CSV, in which a quoted path may hold commas."""
    quoted = str(source.resolve()).replace('"', '""')
    return ",".join(["type=bind", f'"source={quoted}"', f"target={target}", *others])


def _stop(name: str, process: subprocess.Popen[bytes]) -> None:
    """Kill a container, and the client that waits for it."""
    with suppress(OSError, subprocess.TimeoutExpired):
        subprocess.run(
            [_DOCKER, "kill", name], check=False, capture_output=True, timeout=_TIMEOUT_S
        )
    process.kill()


class _Tail:
    """The last bytes of a stream, which is read to its end by a thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._content = b""
        self._stream = stream
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while chunk := self._stream.read1(_TAIL_BYTES):  # type: ignore[attr-defined]
            self._content = (self._content + chunk)[-_TAIL_BYTES:]

    def content(self) -> bytes:
        """Wait for the end of the stream and return its last bytes."""
        self._thread.join(_TIMEOUT_S)
        return self._content


def _reason(printed: bytes) -> str:
    """Return the last line of a program's output that is not empty or Docker's advice."""
    lines = [line.strip() for line in printed.decode(errors="replace").splitlines()]
    useful = [line for line in lines if line and not line.startswith("Run 'docker")]
    return for_terminal(useful[-1][:_REASON_CHARACTERS]) if useful else "it printed no reason"
