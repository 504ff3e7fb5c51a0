"""The mesh of the chessboard that cameras are calibrated with."""

from __future__ import annotations

import numpy as np

from simulate.look.mesh import Mesh, MeshBuilder
from simulate.render.job import Board


def board_mesh(board: Board) -> Mesh:
    """Build a chessboard with a white margin before a grey background, metres.

    The squares are in the plane z = 0 and are seen from below (-z); the margin and the background
    lie behind them. The materials are called "white", "black" and "grey".
    """
    out = MeshBuilder()
    side = board.square_m

    def square(x0: float, x1: float, y0: float, y1: float, z: float, name: str) -> None:
        corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
        out.polygon(np.multiply(corners, [side, side, 1]), name)

    for j in range(-1, board.rows):
        for i in range(-1, board.columns):
            square(i, i + 1, j, j + 1, 0.0, "white" if (i + j) % 2 else "black")
    square(-2, board.columns + 1, -2, board.rows + 1, 1e-3 * side, "white")  # the white margin
    square(-99, 99, -99, 99, 1.0, "grey")
    return out.build()
