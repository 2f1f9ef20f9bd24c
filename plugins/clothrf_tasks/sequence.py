"""An expert made of other experts, each in charge for a while."""

from __future__ import annotations

import bisect
import itertools
from dataclasses import dataclass

from pydantic import ValidationError
from typing_extensions import override

from clothrf_core.errors import ConfigError
from clothrf_core.interfaces import Expert
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.types import Action, ClothState
from clothrf_tasks.config import SequenceConfig


@dataclass(frozen=True, slots=True)
class Sequence(Expert):
    """Answers with the expert whose turn it is at ``state.time_s``.

    Attributes:
        starts: rising times in seconds at which the experts take over; the first is 0.
        experts: one expert a start.
        period: start again after this many seconds; None = the last one stays.
    """

    starts: tuple[float, ...]
    experts: tuple[Expert, ...]
    period: float | None = None

    def turn(self, time_s: float) -> int:
        """Index of the expert in charge at `time_s`."""
        if self.period is not None:
            time_s %= self.period
        return max(0, bisect.bisect_right(self.starts, time_s) - 1)

    @override
    def label(self, state: ClothState) -> Action:
        return self.experts[self.turn(state.time_s)].label(state)


def build_sequence(config: SequenceConfig, context: BuildContext) -> Sequence:
    """The sequence that `config` describes, its experts found in ``context.registry``.

    Raises:
        ConfigError: start times do not rise from 0, or an expert refuses its options.
        UnknownPlugin: an expert of that name is not installed.
    """
    starts = tuple(step.start_s for step in config.steps)
    rising = all(a < b for a, b in itertools.pairwise(starts))
    if starts[0] != 0.0 or not rising:
        raise ConfigError(
            f"expert.steps: expected start_s rising from 0, got {list(starts)}; order the steps"
        )
    if config.period_s is not None and config.period_s <= starts[-1]:
        raise ConfigError(
            f"expert.period_s: expected more than the last start_s {starts[-1]}, got "
            f"{config.period_s}; the last step would never come"
        )
    registry = context.registry or Registry.installed()
    experts = []
    for index, step in enumerate(config.steps):
        provider = registry.find("expert", step.plugin)
        try:
            options = provider.config.model_validate(step.options)
        except ValidationError as error:
            problems = "; ".join(
                f"{'.'.join(map(str, e['loc']))}: {e['msg']} (got {e['input']!r})"
                for e in error.errors()
            )
            raise ConfigError(f"expert.steps.{index}.options of '{step.plugin}': {problems}") from (
                error
            )
        experts.append(registry.build("expert", step.plugin, options, context))
    return Sequence(starts, tuple(experts), config.period_s)
