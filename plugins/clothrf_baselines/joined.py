"""Several extractors as one: one data set from which policies pick by the names' beginnings."""

from __future__ import annotations

import numpy as np
from pydantic import ValidationError
from typing_extensions import override

from clothrf_baselines.config import JoinedConfig
from clothrf_core.errors import ConfigError
from clothrf_core.interfaces import FeatureExtractor
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.types import Features, Observation


class Joined(FeatureExtractor):
    """Features of all parts in order; the anchor of the first; valid only if all parts are."""

    def __init__(
        self, parts: tuple[FeatureExtractor, ...], prefixes: tuple[str, ...] | None = None
    ) -> None:
        self.parts = parts
        before = prefixes or ("",) * len(parts)
        self._names = tuple(
            prefix + name for part, prefix in zip(parts, before, strict=True) for name in part.names
        )

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return self._names

    @override
    def extract(self, observation: Observation) -> Features:
        found = [part.extract(observation) for part in self.parts]
        if not all(part.valid for part in found):
            return Features(
                values=np.zeros(len(self._names), np.float32),
                names=self._names,
                anchor=np.zeros(3),
                valid=False,
            )
        return Features(
            values=np.concatenate([part.values for part in found]),
            names=self._names,
            anchor=found[0].anchor,
        )


def build_joined(config: JoinedConfig, context: BuildContext) -> Joined:
    """The extractors that `config` names, found in ``context.registry``.

    Raises:
        ConfigError: a part refuses its options, or two parts name a feature alike.
        UnknownPlugin: a part is not installed.
    """
    registry = context.registry or Registry.installed()
    parts = []
    for index, part in enumerate(config.parts):
        provider = registry.find("features", part.plugin)
        try:
            options = provider.config.model_validate(part.options)
        except ValidationError as error:
            problems = "; ".join(
                f"{'.'.join(map(str, e['loc']))}: {e['msg']} (got {e['input']!r})"
                for e in error.errors()
            )
            raise ConfigError(
                f"features.parts.{index}.options of '{part.plugin}': {problems}"
            ) from error
        parts.append(registry.build("features", part.plugin, options, context))
    joined = Joined(tuple(parts), tuple(part.prefix for part in config.parts))
    if len(set(joined.names)) < len(joined.names):
        raise ConfigError(
            "features.parts: expected different feature names, got some twice; give a part a prefix"
        )
    return joined
