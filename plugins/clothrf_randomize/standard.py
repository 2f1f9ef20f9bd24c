"""The standard randomiser: each part draws from its own stream, so that none shifts another."""

from __future__ import annotations

import dataclasses

import numpy as np
from typing_extensions import override

from clothrf_core.interfaces import Randomizer
from clothrf_core.params import HandNoise, Randomization
from clothrf_core.types import RgbdFrame, frozen_mapping
from clothrf_randomize.appearance import vary_light
from clothrf_randomize.cloth import vary_cloth, vary_fabric
from clothrf_randomize.config import StandardConfig
from clothrf_randomize.occluders import draw_occluders
from clothrf_randomize.prints import draw_prints
from clothrf_randomize.sensor import Sensor
from clothrf_randomize.viewpoint import vary_camera


class Standard(Randomizer):
    """Hands, cloth, camera, light, textures, occluders, sensor noise, each with a strength.

    ``Randomization.sensor`` holds the strengths of the sensor's parts for one roll-out; a
    `Randomization` without them (a nominal one) leaves frames as they are.
    """

    def __init__(self, config: StandardConfig) -> None:
        self.config = config.effective()
        self._sensor = Sensor(self.config.sensor)

    @override
    def draw(self, rng: np.random.Generator, nominal: Randomization) -> Randomization:
        config = self.config
        fabric, cloth, camera, light, occluders, sensor, texture = (
            np.random.default_rng(seed) for seed in rng.integers(0, 2**63, size=7)
        )
        simulation = dataclasses.replace(
            vary_cloth(cloth, nominal.simulation, config.size, config.mesh),
            fabric=vary_fabric(fabric, nominal.simulation.fabric, config.fabric),
        )
        moved = vary_camera(camera, nominal.camera, config.camera)
        lit, colour = vary_light(light, nominal.light, nominal.cloth_colour, config.light)
        prints = draw_prints(texture, colour, moved, config.texture)
        hand_noise = nominal.hand_noise
        if config.hands.strength > 0.0:
            hand_noise = HandNoise(
                std=config.hands.strength * config.hands.std,
                time_constant_s=config.hands.time_constant_s,
            )
        return Randomization(
            simulation=simulation,
            camera=moved,
            light=lit,
            cloth_colour=colour,
            cloth_pattern=prints.cloth or nominal.cloth_pattern,
            table_pattern=prints.table or nominal.table_pattern,
            backdrop=prints.backdrop or nominal.backdrop,
            hand_noise=hand_noise,
            occluders=nominal.occluders
            + draw_occluders(occluders, moved, simulation, config.occluders),
            sensor=frozen_mapping(self._sensor.draw(sensor)),
        )

    @override
    def corrupt(
        self, frame: RgbdFrame, params: Randomization, rng: np.random.Generator
    ) -> RgbdFrame:
        if not params.sensor:
            return frame
        return self._sensor.apply(frame, params.sensor, rng)
