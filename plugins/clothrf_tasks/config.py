"""Options of the experts and of the hands' motions."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from clothrf_core.rig import Section, Vector

Pair = Annotated[list[Vector], Field(min_length=2, max_length=2)]


class StraightConfig(Section):
    """Options of the straight expert."""

    length: float = Field(0.35, gt=0.0, description="length of the cloth from hand to grasp, m")
    eps: float = Field(
        0.01, gt=0.0, description="hands closer than this on the ground plan count as stacked, m"
    )


class BentConfig(StraightConfig):
    """Options of the bent expert."""

    share: float = Field(0.5, gt=0.0, le=1.0, description="chord over length of the cloth")


class TwistedConfig(StraightConfig):
    """Options of the twisted expert."""

    twist: Literal["feasible", "paper"] = Field(
        "feasible",
        description="feasible: side edges keep their length; paper: the printed 0.31 and 0.15 m, "
        "scaled with length / 0.35, which stretch them by up to 7 %",
    )


class SequenceStep(Section):
    """One part of a sequence."""

    plugin: str = Field(description="name of the expert")
    start_s: float = Field(0.0, ge=0.0, description="simulated time at which it takes over, s")
    options: dict[str, Any] = Field({}, description="that expert's own options")


class SequenceConfig(Section):
    """Options of the sequence expert."""

    steps: list[SequenceStep] = Field(
        [
            SequenceStep(plugin="straight", start_s=0.0),
            SequenceStep(plugin="bent", start_s=4.0),
            SequenceStep(plugin="twisted", start_s=8.0),
        ],
        min_length=1,
        description="experts with rising start times, the first at 0",
    )
    period_s: float | None = Field(
        None, gt=0.0, description="start again after this time; none = the last expert stays, s"
    )


class HandsConfig(Section):
    """Limits shared by all motions; what is not given comes from the rig."""

    rest: Pair | None = Field(None, description="2 x 3 rest corners, world, m; none = the rig's")
    max_distance: float | None = Field(
        None, gt=0.0, description="largest distance of the two hands, m; none = the rig's"
    )
    max_speed: float | None = Field(
        None, gt=0.0, description="per axis and hand, m/s; none = the rig's"
    )


class TargetsConfig(HandsConfig):
    """Options of the random targets."""

    range: Vector | None = Field(
        None, description="half-width of the targets about the rest corners, m; none = the rig's"
    )
    pairing: Literal["independent", "common"] = Field(
        "independent", description="common: one offset for both hands, the pair keeps its shape"
    )
    pause_s: float = Field(0.0, ge=0.0, description="time spent at each target, s")


class ScriptedPose(Section):
    """Where both hands are at one time."""

    time_s: float = Field(ge=0.0, description="s since the start of the motion")
    hands: Pair = Field(description="2 x 3 positions, m, in the script's frame")


class ScriptedConfig(HandsConfig):
    """Options of the scripted motion."""

    poses: list[ScriptedPose] = Field(
        [
            ScriptedPose(time_s=0.0, hands=[[0.0, 0.01, 0.0], [0.0, -0.01, 0.0]]),
            ScriptedPose(time_s=2.0, hands=[[0.0, 0.03, 0.08], [0.0, -0.03, 0.08]]),
            ScriptedPose(time_s=4.0, hands=[[0.0, 0.03, -0.08], [0.0, -0.03, -0.08]]),
            ScriptedPose(time_s=6.0, hands=[[0.0, 0.01, 0.0], [0.0, -0.01, 0.0]]),
        ],
        min_length=1,
        description="poses with rising times, the first at 0; straight lines in between",
    )
    frame: Literal["world", "rest"] = Field(
        "rest", description="rest: poses are offsets from the rest corners"
    )
    repeat: bool = Field(False, description="start again at the end instead of staying there")


class StillConfig(HandsConfig):
    """Options of the hands that do not move."""

    hands: Pair | None = Field(
        None, description="2 x 3 positions, world, m; none = the rest corners"
    )
