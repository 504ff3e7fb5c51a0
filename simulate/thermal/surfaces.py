"""The temperature of surfaces: each follows sun, air and sky with the delay of its substance.

A thin layer absorbs sunlight, and exchanges heat with the air, the sky and the ground, water or
room behind it. Its energy balance is linear in its temperature. The temperature therefore tends to
an equilibrium with a time constant, and is the mean of the equilibria of past hours with
exponentially falling weights (lumped capacity; Incropera et al., Fundamentals of Heat and Mass
Transfer, chapter 5).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulate.thermal.substances import NAMES, SUBSTANCES, property_array
from simulate.thermal.weather import HOURS, STEFAN_BOLTZMANN, ZERO_C, ThermalWeather

Float = NDArray[np.float32]

_INDOORS_K: Final = ZERO_C + 20.0
# Share of the sunlight on a soaked surface that evaporates its water.
_WET_EVAPORATION: Final = 0.5


class Surfaces:
    """The response of every substance to a weather.

    Args:
        weather: The weather of the past hours.
        wet: Wetness of surfaces, 0 to 1.

    Attributes:
        weights: Weight of each past hour by substance, (substances, HOURS); each row has the sum 1.
    """

    def __init__(self, weather: ThermalWeather, wet: float) -> None:
        backing_k = {"ground": weather.ground_k, "water": weather.water_k, "indoors": _INDOORS_K}
        emissivity = property_array("emissivity")
        radiative = emissivity * 4 * STEFAN_BOLTZMANN * float(weather.air_k[0]) ** 3
        conductance = property_array("conductance")
        exchange = property_array("transfer") + radiative + conductance
        decay = np.exp(-np.arange(HOURS)[None, :] / property_array("hours")[:, None])
        self.weights = decay / decay.sum(1, keepdims=True)
        air = self.weights @ weather.air_k
        inner = np.array([backing_k[SUBSTANCES[name].backing] for name in NAMES])
        # Temperature (K) without sunlight and sky, and the effects of a full view of the sky (K)
        # and of absorbed sunlight (K per W/m2).
        self._base_k = (air + conductance / exchange * (inner - air)).astype(np.float32)
        self._loss = (emissivity * weather.loss_w / exchange).astype(np.float32)
        evaporation = np.maximum(property_array("evaporation"), _WET_EVAPORATION * wet)
        self._gain = ((1 - evaporation) / exchange).astype(np.float32)

    def temperature(
        self, substance: NDArray[np.int16], albedo: Float, sunlight: Float, sky_view: Float
    ) -> Float:
        """Return the temperature of surfaces, kelvin; all arrays have the same shape.

        Args:
            substance: Indices of the substances.
            albedo: Shares of sunlight that the surfaces reflect.
            sunlight: Irradiance averaged over the past hours with the weights of the substance,
                W/m2.
            sky_view: Shares of the sky in the half space that the surfaces face, 0 to 1.
        """
        return np.asarray(
            self._base_k[substance]
            - self._loss[substance] * sky_view
            + self._gain[substance] * (1 - albedo) * sunlight,
            np.float32,
        )
