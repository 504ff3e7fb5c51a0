"""Conversion of COLMAP's camera models to equivalent models of this project.

A fisheye with fewer coefficients is an OPENCV_FISHEYE with zeros. A model with more coefficients
is equivalent to a smaller model if the additional ones are zero: FULL_OPENCV is converted to OPENCV
in this case only. A model without an equivalent is an error: no camera is approximated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from objconnect.scene.errors import InputError

_FISHEYE: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
_PINHOLE: Final = ("fx", "fy", "cx", "cy")

# Our model, and COLMAP's parameters under our names. Parameters that our model lacks must be zero.
_EQUIVALENT: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "SIMPLE_FISHEYE": ("OPENCV_FISHEYE", ("f", "cx", "cy")),
    "FISHEYE": ("OPENCV_FISHEYE", _PINHOLE),
    "SIMPLE_RADIAL_FISHEYE": ("OPENCV_FISHEYE", ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": ("OPENCV_FISHEYE", ("f", "cx", "cy", "k1", "k2")),
    "THIN_PRISM_FISHEYE": (
        "OPENCV_FISHEYE",
        (*_PINHOLE, "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    ),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        "OPENCV_FISHEYE",
        (*_FISHEYE, "k5", "k6", "p1", "p2", "s1", "s2", "s3", "s4"),
    ),
    "FOV": ("PINHOLE", (*_PINHOLE, "omega")),
    "SIMPLE_DIVISION": ("SIMPLE_PINHOLE", ("f", "cx", "cy", "k")),
    "DIVISION": ("PINHOLE", (*_PINHOLE, "k")),
}
_OUR_PARAMETERS: Final = {
    "OPENCV_FISHEYE": _FISHEYE,
    "PINHOLE": _PINHOLE,
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
}

MODEL_IDS: Final[dict[int, str]] = {
    0: "SIMPLE_PINHOLE",
    1: "PINHOLE",
    2: "SIMPLE_RADIAL",
    3: "RADIAL",
    4: "OPENCV",
    5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV",
    7: "FOV",
    8: "SIMPLE_RADIAL_FISHEYE",
    9: "RADIAL_FISHEYE",
    10: "THIN_PRISM_FISHEYE",
    11: "RAD_TAN_THIN_PRISM_FISHEYE",
    12: "SIMPLE_DIVISION",
    13: "DIVISION",
    14: "SIMPLE_FISHEYE",
    15: "FISHEYE",
    16: "EUCM",
    17: "EQUIRECTANGULAR",
}
"""COLMAP's model names by their identifiers in binary files."""

# Numbers of parameters. FULL_OPENCV begins with the parameters of OPENCV.
_FULL_OPENCV_COUNT, _OPENCV_COUNT = 12, 8

CONVERTIBLE_MODELS: Final = tuple(_EQUIVALENT)
"""Models of COLMAP that are converted to another model."""


def parameter_count(model: str) -> int | None:
    """Return the number of parameters of a convertible model; None for other models."""
    return len(_EQUIVALENT[model][1]) if model in _EQUIVALENT else None


def convert_model(model: str, params: Sequence[float]) -> tuple[str, tuple[float, ...]]:
    """Return the supported model that projects every point to the same pixel.

    Args:
        model: COLMAP's name; models other than ``CONVERTIBLE_MODELS`` and FULL_OPENCV are returned
            unchanged.
        params: parameters in COLMAP's order.

    Returns:
        Name and parameters of the equivalent model.

    Raises:
        InputError: a coefficient that the equivalent model lacks is not zero, or the number of
            parameters is wrong.

    Examples:
        >>> convert_model("SIMPLE_RADIAL_FISHEYE", (500.0, 320.0, 240.0, 0.01))
        ('OPENCV_FISHEYE', (500.0, 500.0, 320.0, 240.0, 0.01, 0.0, 0.0, 0.0))
    """
    if (
        model == "FULL_OPENCV"
        and len(params) == _FULL_OPENCV_COUNT
        and not any(params[_OPENCV_COUNT:])
    ):
        return "OPENCV", tuple(params[:_OPENCV_COUNT])
    if model not in _EQUIVALENT:
        return model, tuple(params)
    ours, names = _EQUIVALENT[model]
    if len(params) != len(names):
        raise InputError(f"camera model {model} takes {len(names)} parameters, got {len(params)}")
    value = dict(zip(names, params, strict=True))
    if "f" in value and "f" not in _OUR_PARAMETERS[ours]:
        value["fx"] = value["fy"] = value.pop("f")
    nonzero = [name for name in value if name not in _OUR_PARAMETERS[ours] and value[name] != 0]
    if nonzero:
        raise InputError(
            f"camera model {model} is supported only where {', '.join(nonzero)} "
            f"{'is' if len(nonzero) == 1 else 'are'} zero: undistort the photographs, or calibrate "
            f"them as {ours}"
        )
    return ours, tuple(value.get(name, 0.0) for name in _OUR_PARAMETERS[ours])
