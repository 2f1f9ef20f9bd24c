"""Picture to numbers: the histogram of oriented wrinkles and metric shape channels."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import FeatureExtractor
from clothrf_core.provider import Benchmark, BuildContext, Figure, Provider
from clothrf_how.config import FeatureOptions, HowOnlyOptions


@hookimpl
def clothrf_features() -> Sequence[Provider[FeatureExtractor]]:
    """Wrinkles with shape channels, and wrinkles alone."""
    return [
        Provider("how", "oriented wrinkles and the cloth's shape in metres", _how,
                 config=FeatureOptions, extra="fast,vision"),
        Provider("how_only", "the 768 oriented wrinkles of the paper, nothing else", _how_only,
                 config=HowOnlyOptions, extra="fast,vision"),
    ]  # fmt: skip


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Time from a picture to its numbers."""
    return [Benchmark("core", "features", _bench, needs="fast,vision")]


def _how(config: FeatureOptions, context: BuildContext) -> FeatureExtractor:
    from clothrf_how.extractor import Extractor

    return Extractor(config, context.rig)


def _how_only(config: HowOnlyOptions, context: BuildContext) -> FeatureExtractor:
    from clothrf_how.extractor import Extractor

    options = FeatureOptions(groups=("how",), foreground=config.foreground, how=config.how)
    return Extractor(options, context.rig)


def _bench(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_how.bench import features

    return features(quick=quick)
