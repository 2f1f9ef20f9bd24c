"""Which method a name stands for; imports only the one that is asked for."""

from __future__ import annotations

from clothrf_baselines.method import Method


def method_of(name: str) -> Method:
    """The method of the baseline `name`.

    Raises:
        ImportError: a package it needs is not installed.
    """
    match name:
        case "constant" | "linear" | "ridge":
            from clothrf_baselines.linear import Constant, Linear, Ridge

            plain: dict[str, Method] = {
                "constant": Constant(),
                "linear": Linear(),
                "ridge": Ridge(),
            }
            return plain[name]
        case "mlp128":
            from clothrf_baselines.mlp import Mlp

            return Mlp()
        case "knn_how" | "knn_depth64":
            from clothrf_baselines.neighbours import DepthNeighbours, HowNeighbours

            return HowNeighbours() if name == "knn_how" else DepthNeighbours()
        case "vfd_sparse":
            from clothrf_baselines.dictionary import SparseDictionary

            return SparseDictionary()
        case "vfd_lasso":
            from clothrf_baselines.lasso import LassoDictionary

            return LassoDictionary()
        case "forest_sklearn" | "extra_trees":
            from clothrf_baselines.trees import Trees

            return Trees(extra=name == "extra_trees")
        case "cnn_depth":
            from clothrf_baselines.cnn import Cnn

            return Cnn()
    raise ValueError(f"no baseline is called '{name}'")
