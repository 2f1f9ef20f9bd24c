"""Experts of the three tasks and of sequences of them, and motions of the person's hands."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Expert, HandMotion
from clothrf_core.provider import BuildContext, Provider
from clothrf_tasks.config import (
    BentConfig,
    ScriptedConfig,
    SequenceConfig,
    StillConfig,
    StraightConfig,
    TargetsConfig,
    TwistedConfig,
)


@hookimpl
def clothrf_experts() -> Sequence[Provider[Expert]]:
    """Straight, bent, twisted, and a sequence of any experts."""
    return [
        Provider("straight", "the cloth lies flat between hands and grippers", _straight,
                 config=StraightConfig),
        Provider("bent", "the cloth hangs in an arc: grippers half a length away", _bent,
                 config=BentConfig),
        Provider("twisted", "the grippers hold the cloth a quarter turn twisted", _twisted,
                 config=TwistedConfig),
        Provider("sequence", "several experts one after the other in time", _sequence,
                 config=SequenceConfig),
    ]  # fmt: skip


@hookimpl
def clothrf_hands() -> Sequence[Provider[HandMotion]]:
    """Random targets, a script of timed poses, or no motion."""
    return [
        Provider("targets", "move between random legal targets, both hands together", _targets,
                 config=TargetsConfig),
        Provider("scripted", "pass through a list of timed poses", _scripted,
                 config=ScriptedConfig),
        Provider("still", "stay at the rest corners or at a given pose", _still,
                 config=StillConfig),
    ]  # fmt: skip


def _straight(config: StraightConfig, context: BuildContext) -> Expert:
    from clothrf_tasks.experts import Straight

    return Straight(length=config.length, eps=config.eps)


def _bent(config: BentConfig, context: BuildContext) -> Expert:
    from clothrf_tasks.experts import Bent

    return Bent(length=config.length, share=config.share, eps=config.eps)


def _twisted(config: TwistedConfig, context: BuildContext) -> Expert:
    from clothrf_tasks.experts import Twisted

    return Twisted(length=config.length, twist=config.twist, eps=config.eps)


def _sequence(config: SequenceConfig, context: BuildContext) -> Expert:
    from clothrf_tasks.sequence import build_sequence

    return build_sequence(config, context)


def _targets(config: TargetsConfig, context: BuildContext) -> HandMotion:
    from clothrf_tasks.hand_limits import hand_limits
    from clothrf_tasks.targets import RandomTargets

    return RandomTargets(
        hand_limits(config, context, reach=config.range),
        pause=config.pause_s,
        pairing=config.pairing,
    )


def _scripted(config: ScriptedConfig, context: BuildContext) -> HandMotion:
    from clothrf_tasks.hand_limits import hand_limits
    from clothrf_tasks.scripted import build_scripted

    return build_scripted(config, hand_limits(config, context))


def _still(config: StillConfig, context: BuildContext) -> HandMotion:
    from clothrf_tasks.hand_limits import hand_limits
    from clothrf_tasks.scripted import build_still

    return build_still(config, hand_limits(config, context))
