"""Policies to compare the forest with, from a constant to a small convolutional net."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from clothrf_baselines.config import (
    BaselineConfig,
    CnnConfig,
    DepthConfig,
    DepthNeighboursConfig,
    DictionaryConfig,
    HowNeighboursConfig,
    JoinedConfig,
    LassoConfig,
    MlpConfig,
    RidgeConfig,
    TreesConfig,
)
from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import FeatureExtractor, Policy
from clothrf_core.provider import BuildContext, Provider
from clothrf_core.rig import Section


@hookimpl
def clothrf_features() -> Sequence[Provider[FeatureExtractor]]:
    """Small depth pictures, and several extractors in one."""
    return [
        Provider("depth64", "the depth picture at 64 x 64, and the grasp", _depth64,
                 config=DepthConfig),
        Provider("joined", "the features of several extractors, one after the other", _joined,
                 config=JoinedConfig),
    ]  # fmt: skip


@hookimpl
def clothrf_policies() -> Sequence[Provider[Policy]]:
    """All baselines."""

    def offer(name: str, summary: str, config: type[Section], extra: str = "") -> Provider[Policy]:
        return Provider(name, summary, _builder(name), config=config, extra=extra)

    return [
        offer("constant", "the mean action of the training rows", BaselineConfig),
        offer("linear", "least squares without regularisation", BaselineConfig),
        offer(
            "ridge", "ridge regression, strength by cross-validation over roll-outs", RidgeConfig
        ),
        offer("mlp128", "a net with one hidden layer of 128", MlpConfig),
        offer("knn_how", "mean action of the k nearest pictures, L1", HowNeighboursConfig),
        offer("knn_depth64", "action of the nearest small depth picture", DepthNeighboursConfig),
        offer("vfd_sparse", "visual feedback dictionary: sparse mix of atoms", DictionaryConfig),
        offer(
            "vfd_lasso", "visual feedback dictionary: Lasso on differences", LassoConfig, "forest"
        ),
        offer("forest_sklearn", "scikit-learn's regression forest", TreesConfig, "forest"),
        offer("extra_trees", "scikit-learn's extremely randomised trees", TreesConfig, "forest"),
        offer("cnn_depth", "a small convolutional net on depth", CnnConfig, "torch"),
    ]


def _builder(name: str) -> Callable[[Any, BuildContext], Policy]:
    def build(config: BaselineConfig, context: BuildContext) -> Policy:
        from clothrf_baselines.methods import method_of
        from clothrf_baselines.policy import Baseline

        return Baseline(name, config, method_of(name))

    return build


def _depth64(config: DepthConfig, context: BuildContext) -> FeatureExtractor:
    from clothrf_baselines.depth64 import Depth64

    return Depth64(config, context.rig)


def _joined(config: JoinedConfig, context: BuildContext) -> FeatureExtractor:
    from clothrf_baselines.joined import build_joined

    return build_joined(config, context)
