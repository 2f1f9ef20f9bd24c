"""Options of the features. Lengths in pixels are of the working picture, others in metres."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clothrf_core.rig import Section

Group = Literal[
    "how",
    "pose",
    "moments",
    "extremes",
    "contour",
    "border",
    "heightmap",
    "blocks",
    "corners",
    "cases",
]

# The best set of the ablation in `extractor.py`.
DEFAULT_GROUPS: tuple[Group, ...] = (
    "corners",
    "cases",
    "extremes",
    "contour",
    "border",
    "moments",
    "pose",
)


class ForegroundOptions(Section):
    """What counts as cloth; where it may be (depth range, box, hue) is the rig's to say."""

    halve: bool = Field(
        True, description="work on 2 x 2 pixel blocks (320 x 240 of 640 x 480); False = every pixel"
    )
    median: Literal[1, 3, 5] = Field(
        3,
        description="depth is the median of so many pixels squared, 1 = as measured; a sensor "
        "twice as noisy as any that was trained on does not tear the cloth to pieces",
    )
    jump: float = Field(
        0.02, gt=0.0, description="m; neighbours farther apart in depth are not one surface"
    )
    keep_share: float = Field(
        0.015,
        gt=0.0,
        le=1.0,
        description="further pieces are kept from this share of the largest piece on",
    )
    stand_off: float = Field(
        0.12,
        gt=0.0,
        description="m; a further piece that is before or behind the largest one by this where "
        "they meet is an arm or the background; folds of the cloth are less apart",
    )
    colour_tolerance: float = Field(
        0.08,
        ge=0.0,
        description="pixels whose (r, g) / (r + g + b) is farther than this from the median of "
        "what may be cloth, or than its scatter, are a hand or a gripper; 0 = do not look; the "
        "rig's hue comes first",
    )
    complete: int = Field(
        40,
        ge=0,
        description="px; the cloth is grown this far over pixels of its colour without depth that "
        "fits, where the background has another colour; 0 = not",
    )
    fill_gap: int = Field(
        8, ge=0, description="px; holes up to this wide, and thin things in front, are bridged"
    )
    min_share: float = Field(
        0.002, gt=0.0, le=1.0, description="share of the picture below which there is no cloth"
    )


class HowOptions(Section):
    """Histogram of oriented wrinkles (Jia et al. 2018; method of 768 numbers)."""

    layout: Literal["A", "B", "C", "D"] = Field(
        "A",
        description="A: 4 orientations x 16 x 12 cells. B: 8 x 8 x 6 x (grey, depth). "
        "C: 8 x 2 wavelengths x 8 x 6. D: 32 x 24 block means of depth, no Gabor",
    )
    align: Literal["none", "center", "center_scale"] = Field(
        "none", description="move (and scale) the foreground to the middle of the cell grid"
    )
    channel: Literal["depth", "grey"] = Field(
        "depth", description="picture that layouts A and C filter"
    )
    relief: Literal["median", "plane", "quadric"] = Field(
        "plane", description="what is subtracted from the depth before filtering"
    )
    sigma: float = Field(3.0, gt=0.0, description="px; standard deviation across the wrinkle")
    wavelength: float = Field(5.0, gt=1.0, description="px")
    second_wavelength: float = Field(10.0, gt=1.0, description="px; layout C only (sigma scales)")
    gamma: float = Field(0.5, gt=0.0, description="sigma over the standard deviation along it")
    psi: float = Field(0.0, description="phase, radians")
    kernel_size: int = Field(31, ge=3, description="px, odd")
    zero_mean: bool = Field(True, description="kernels that do not answer to a constant")
    unit_norm: bool = Field(True, description="kernels of unit L2 norm")
    response: Literal["half", "magnitude", "energy", "saturate8"] = Field(
        "half",
        description="half: negative answers are 0. magnitude: |answer|. energy: root of the sum "
        "of squares of a quadrature pair. saturate8: to [0, 255], as 8-bit filters do",
    )
    every: Literal[1, 2] = Field(
        2,
        description="sum the answers of every pixel or, along a wrinkle, of every second one "
        "(layout A with normed kernels; a tenth less time, 2 % of the histogram moves)",
    )
    normalise: Literal["l1", "none"] = Field("l1", description="of the whole histogram")

    @model_validator(mode="after")
    def _odd(self) -> HowOptions:
        if self.kernel_size % 2 == 0:
            raise ValueError(f"kernel_size must be odd, got {self.kernel_size}")
        return self


class FeatureOptions(Section):
    """`[features] plugin = "how"`."""

    groups: tuple[Group, ...] = Field(
        DEFAULT_GROUPS, min_length=1, description="feature groups, in this order"
    )
    foreground: ForegroundOptions = ForegroundOptions()
    how: HowOptions = HowOptions()

    @model_validator(mode="after")
    def _once(self) -> FeatureOptions:
        if len(set(self.groups)) != len(self.groups):
            raise ValueError(f"groups name one twice: {', '.join(self.groups)}")
        return self


class HowOnlyOptions(Section):
    """`[features] plugin = "how_only"`: the 768 numbers and nothing else."""

    foreground: ForegroundOptions = ForegroundOptions()
    how: HowOptions = HowOptions()
