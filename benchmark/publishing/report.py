"""The report of ``publish``: scenes, photographs and bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmark.publishing.rows import Split


@dataclass(frozen=True)
class Sizes:
    """Bytes that a published folder takes, as expected before it is written.

    Attributes:
        photographs: bytes of the photographs.
        maps: bytes of the maps, with the lists of objects.
        layers: bytes that the layers take in the scenes, compressed; the shards need about as much.
    """

    photographs: int
    maps: int
    layers: int

    @staticmethod
    def sum(sizes: Iterable[Sizes]) -> Sizes:
        """Return the sum of the sizes of several scenes."""
        scenes = list(sizes)
        return Sizes(
            photographs=sum(scene.photographs for scene in scenes),
            maps=sum(scene.maps for scene in scenes),
            layers=sum(scene.layers for scene in scenes),
        )

    @property
    def total(self) -> int:
        """Sum of all bytes."""
        return self.photographs + self.maps + self.layers


@dataclass(frozen=True)
class PublishReport:
    """A published folder.

    Attributes:
        out: the folder.
        scenes: names of the scenes.
        photographs: number of photographs by split.
        left_out: number of photographs in no split, which are not published.
        sizes: bytes that were expected before writing.
        written: bytes of all files; None after a dry run.
        unstated: facts that Croissant asks for and that were not stated.
    """

    out: Path
    scenes: tuple[str, ...]
    photographs: Mapping[Split, int]
    left_out: int
    sizes: Sizes
    written: int | None
    unstated: tuple[str, ...]

    def text(self) -> str:
        """Return the report as a few lines of text."""
        counts = (
            f"{self.photographs['map']} map photographs and {self.photographs['query']} queries"
        )
        sizes = self.sizes
        parts = f"photographs {sizes.photographs}, maps {sizes.maps}, layers {sizes.layers}"
        if self.written is None:
            lines = [f"{self.out} would hold about {sizes.total} bytes: {parts}"]
        else:
            lines = [f"{self.out}: {self.written} bytes"]
        lines.append(f"{counts} of {', '.join(self.scenes)}")
        if self.left_out:
            lines.append(f"{self.left_out} photographs are in no split and are left out")
        if self.unstated:
            options = ", ".join(f"--{name}" for name in self.unstated)
            lines.append(f"Croissant recommends {options}, which were not given")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for a program."""
        return {**asdict(self), "out": str(self.out), "total": self.sizes.total}
