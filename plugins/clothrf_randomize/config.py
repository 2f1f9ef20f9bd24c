"""Options of the standard randomiser. Every part has a `strength`: 0 = off, 1 = as described."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import Field

from clothrf_core.rig import Section

Family = Literal["sr300", "d435", "kinect", "disparity", "stereo"]
Part = Literal[
    "hands", "fabric", "size", "mesh", "camera", "light", "texture", "occluders", "sensor"
]
# How a strength becomes the strength of one roll-out.
Episode = Literal["uniform", "fixed"]


class HandsNoise(Section):
    """Perturbed hands: an Ornstein-Uhlenbeck process (the paper perturbs, gives no numbers)."""

    strength: float = Field(1.0, ge=0.0)
    std: float = Field(0.005, ge=0.0, description="stationary, per axis, m")
    time_constant_s: float = Field(0.3, gt=0.0, description="correlation time, s")


class FabricSpread(Section):
    """Material of the cloth."""

    strength: float = Field(1.0, ge=0.0)
    mode: Literal["scale", "catalogue"] = Field(
        "scale",
        description="scale: every parameter times its own log-uniform factor; catalogue: one of "
        "ten fabrics, then scaled",
    )
    factor: float = Field(2.0, ge=1.0, description="factors lie in [1 / factor, factor]")


class SizeSpread(Section):
    """Size of the cloth."""

    strength: float = Field(1.0, ge=0.0)
    spread: float = Field(0.03, ge=0.0, lt=0.5, description="+- share of each side")


class MeshSpread(Section):
    """Resolution of the simulated mesh: what discretisation must not teach."""

    strength: float = Field(1.0, ge=0.0)
    vertices: int = Field(2, ge=0, description="+- vertices along each side")


class CameraSpread(Section):
    """Errors of the camera's calibration; the policy is told the nominal camera all the same.

    The defaults are what a good hand-eye and intrinsic calibration leaves (1-2 mm, 0.1-0.3 deg,
    0.1-0.2 % of f). For a camera placed by eye take 0.02 m, 2 deg, 0.02 and 5 px.
    """

    strength: float = Field(1.0, ge=0.0)
    position: float = Field(0.003, ge=0.0, description="+- per axis, m")
    rotation_deg: float = Field(0.3, ge=0.0, description="+- per axis, degrees")
    focal: float = Field(0.002, ge=0.0, lt=0.5, description="+- share of fx and of fy")
    centre_px: float = Field(1.0, ge=0.0, description="+- of cx and of cy, pixels")


class LightSpread(Section):
    """Light and colour of the cloth; matters where features read colour."""

    strength: float = Field(1.0, ge=0.0)
    direction_deg: float = Field(30.0, ge=0.0, le=80.0, description="cone about nominal, degrees")
    intensity: float = Field(0.3, ge=0.0, description="+- share of the directional light")
    ambient: float = Field(0.3, ge=0.0, description="+- share of the ambient light")
    hue_deg: float = Field(10.0, ge=0.0, le=180.0, description="+- hue of the cloth, degrees")
    saturation: float = Field(0.15, ge=0.0, le=1.0, description="+- saturation of the cloth")
    value: float = Field(0.15, ge=0.0, le=1.0, description="+- brightness of the cloth")


class TextureSpread(Section):
    """What is printed on cloth, table and backdrop; matters where features read colour.

    Each of the three is plain, a gradient, a chequer, stripes or speckles, at random.
    """

    strength: float = Field(1.0, ge=0.0)
    cloth: float = Field(
        0.35, ge=0.0, le=1.0, description="brightness of the cloth's other shades, +- share"
    )
    cloth_hue_deg: float = Field(
        5.0, ge=0.0, le=180.0, description="+- hue of the cloth's other shades, degrees"
    )
    ground: float = Field(
        0.5, ge=0.0, le=1.0, description="share of the way to any colour that table and backdrop go"
    )
    keep_off_deg: float = Field(
        60.0,
        ge=0.0,
        le=175.0,
        description="hues this near to the cloth's are the cloth's alone, degrees",
    )


class Occluders(Section):
    """Capsules and plates between the camera and the cloth, still during a roll-out."""

    strength: float = Field(1.0, ge=0.0)
    share: float = Field(0.15, ge=0.0, le=0.9, description="of the cloth that is hidden at most")
    count: int = Field(2, ge=1, le=8, description="occluders at most")
    episode: Episode = Field(
        "uniform",
        description="uniform: 0 to `count` occluders that hide up to strength * share; fixed: "
        "always strength * share",
    )
    near: float = Field(0.35, gt=0.0, lt=1.0, description="nearest place, share of the way")
    far: float = Field(0.70, gt=0.0, lt=1.0, description="farthest place, share of the way")
    measurable: bool = Field(True, description="False: the sensor reads no depth on them")


class SensorNoise(Section):
    """Depth noise. The sub-strengths multiply `strength`; 0 switches that part off."""

    strength: float = Field(1.0, ge=0.0)
    family: Family = Field("sr300", description="which sensor's errors")
    episode: Episode = Field(
        "uniform",
        description="uniform: each part of a roll-out has strength * U(0, 2); fixed: strength",
    )
    jitter: float = Field(1.0, ge=0.0, description="wobbling edges")
    axial: float = Field(1.0, ge=0.0, description="noise of each pixel along the ray")
    smooth: float = Field(1.0, ge=0.0, description="noise shared by neighbouring pixels")
    incidence: float = Field(1.0, ge=0.0, description="noise and drop-outs of slanted surfaces")
    edges: float = Field(1.0, ge=0.0, description="drop-outs, most of them near edges")
    holes: float = Field(1.0, ge=0.0, description="blobs without depth")
    offset: float = Field(1.0, ge=0.0, description="bias and scale error of a roll-out")
    cosine_drop: bool = Field(
        False,
        description="kinect only: lose a share 1 - cos(incidence) of the pixels, an add-on of "
        "some simulators (29 % at 45 degrees); otherwise only surfaces beyond 70 degrees",
    )
    quantise: bool = Field(True, description="round to the sensor's unit")
    bias_std: float = Field(0.002, ge=0.0, description="of a roll-out, m")
    scale_std: float = Field(0.005, ge=0.0, description="of a roll-out, share")


class StandardConfig(Section):
    """Options of the standard randomiser."""

    only: list[Part] | None = Field(
        None, description="parts that are on, the others have strength 0; none = all are on"
    )
    hands: HandsNoise = HandsNoise()
    fabric: FabricSpread = FabricSpread()
    size: SizeSpread = SizeSpread()
    mesh: MeshSpread = MeshSpread()
    camera: CameraSpread = CameraSpread()
    light: LightSpread = LightSpread()
    texture: TextureSpread = TextureSpread()
    occluders: Occluders = Occluders()
    sensor: SensorNoise = SensorNoise()

    def effective(self) -> StandardConfig:
        """The same with the strengths that `only` leaves."""
        if self.only is None:
            return self
        off = {part: getattr(self, part) for part in get_args(Part) if part not in self.only}
        return self.model_copy(
            update={p: section.model_copy(update={"strength": 0.0}) for p, section in off.items()}
        )
