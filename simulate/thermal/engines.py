"""The heat of engines and tyres of vehicles that are, or were lately, driven."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulate.place.world import World

Float = NDArray[np.float32]

# Where the engine begins along a vehicle, as a share of its length from the middle, and the share
# over which its heat fades in: the bonnet of a car, the cab of a van or a lorry.
_ENGINES: Final[dict[str, tuple[float, float]]] = {
    "car": (0.24, 0.08),
    "van": (0.34, 0.06),
    "truck": (0.32, 0.06),
    "tractor": (0.05, 0.1),
}
# Excess temperatures of vehicles in traffic: of the bonnet, and of the low parts (tyres, brakes and
# exhaust). Low parts lie below this height from the vehicle's centre, as a share of its height.
_ENGINE_K: Final = 22.0
_LOW_PARTS_K: Final = 9.0
_LOW_SHARE: Final = -0.22
_COOLING_H: Final = 0.7  # time constant of an engine that was switched off
_PARKED_H: Final = 5.0  # mean time for which vehicles have been parked


class Engines:
    """The warmth of the vehicles of a place.

    How long a vehicle has been parked depends on the place and the vehicle alone.

    Args:
        world: The place.
    """

    def __init__(self, world: World) -> None:
        count = max((item.id for item in world.objects), default=0) + 1
        self._warmth = np.zeros(count, np.float32)
        self._frame = np.zeros((count, 7), np.float32)  # centre, cos, sin, length, height
        self._engine = np.ones((count, 2), np.float32)
        for item in world.objects:
            if item.class_name not in _ENGINES:
                continue
            hours = np.random.default_rng([world.seed, item.random_key, 7]).exponential(_PARKED_H)
            self._warmth[item.id] = 1.0 if item.driven else np.exp(-hours / _COOLING_H)
            turn = np.cos(item.yaw), np.sin(item.yaw)
            self._frame[item.id] = (*item.centre, *turn, item.size[0], item.size[2])
            self._engine[item.id] = _ENGINES[item.class_name]

    def __call__(self, instance: NDArray[np.uint16], points: Float) -> Float:
        """Return by how much engines warm each pixel (H, W), kelvin.

        Args:
            instance: Ids (H, W) of the objects.
            points: World points (H, W, 3), metres.
        """
        heat = np.zeros(instance.shape, np.float32)
        warm = self._warmth[instance] > 0.01
        ids = instance[warm]
        frame, engine = self._frame[ids], self._engine[ids]
        offset = points[warm] - frame[:, :3]
        along = (offset[:, 0] * frame[:, 3] + offset[:, 1] * frame[:, 4]) / frame[:, 5]
        low = np.clip((_LOW_SHARE - offset[:, 2] / frame[:, 6]) / 0.1, 0, 1)
        front = np.clip((along - engine[:, 0]) / engine[:, 1], 0, 1)
        heat[warm] = self._warmth[ids] * np.maximum(_ENGINE_K * front, _LOW_PARTS_K * low)
        return heat
