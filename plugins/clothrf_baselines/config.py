"""Options of the baselines and of their features."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from clothrf_core.rig import Section


class BaselineConfig(Section):
    """Options that all baselines share."""

    target_frame: Literal["anchor", "world"] = Field(
        "anchor", description="targets relative to the anchor of the picture, or absolute"
    )
    use_anchor: bool = Field(True, description="the anchor's place is three more features")
    prefix: str = Field("", description="use only features whose names begin so; '' = all")
    scale_inputs: bool = Field(True, description="features to mean 0 and standard deviation 1")
    scale_targets: bool = Field(True, description="targets to mean 0 and standard deviation 1")


class RidgeConfig(BaselineConfig):
    """Options of ridge regression."""

    alpha: float | None = Field(
        None, ge=0.0, description="strength for scaled features; none = by cross-validation"
    )
    folds: int = Field(5, ge=2, description="groups of roll-outs left out in turn")


class MlpConfig(BaselineConfig):
    """Options of the net with one hidden layer."""

    hidden: int = Field(
        128,
        ge=1,
        description="units of the hidden layer",
        json_schema_extra={"tune": [64, 128, 256]},
    )
    epochs: int = Field(100, ge=1, description="passes over the rows at most")
    patience: int = Field(10, ge=1, description="passes without progress on held-out roll-outs")
    batch: int = Field(64, ge=1, description="rows a step")
    rate: float = Field(1e-3, gt=0.0, description="step size of Adam")
    decay: float = Field(
        1e-4,
        ge=0.0,
        description="weight decay",
        json_schema_extra={"tune": [1e-4, 1e-3, 1e-2]},
    )
    held_out: float = Field(0.1, gt=0.0, lt=1.0, description="share of roll-outs for stopping")


class HowNeighboursConfig(BaselineConfig):
    """Options of the nearest neighbours on wrinkles."""

    prefix: str = "how"
    use_anchor: bool = False
    scale_inputs: bool = False
    k: int = Field(
        5,
        ge=1,
        description="neighbours; 1, 5 and 10 are the usual ones",
        json_schema_extra={"tune": [1, 5, 10]},
    )
    weights: Literal["uniform", "inverse"] = Field(
        "uniform", description="mean, or weighted by 1 / distance"
    )


class DepthNeighboursConfig(BaselineConfig):
    """Options of the nearest neighbour on small depth pictures, as once run on the robot."""

    prefix: str = "depth64"
    target_frame: Literal["anchor", "world"] = "world"
    use_anchor: bool = False
    scale_inputs: bool = False
    k: int = Field(1, ge=1, description="neighbours", json_schema_extra={"tune": [1, 3, 10]})
    rows: Literal["lower", "all"] = Field("lower", description="half of the picture compared")
    gate: float = Field(
        0.10,
        ge=0.0,
        description="only rows whose grippers were each this near, m; no such row = hold; 0 = all. "
        "Needs the six 'depth64_grasp' features",
    )


class DictionaryConfig(BaselineConfig):
    """Options of the dictionary of atoms."""

    atoms: int = Field(
        1000,
        ge=2,
        le=20000,
        description="atoms at most, by k-means",
        json_schema_extra={"tune": [300, 1000, 2000]},
    )
    alpha: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="L1 strength over the largest correlation; none = by held-out roll-outs",
    )
    working_set: int = Field(64, ge=1, description="atoms offered to one word")
    iterations: int = Field(200, ge=1, description="of the solver of one word")


class LassoConfig(BaselineConfig):
    """Options of the dictionary of differences."""

    mode: Literal["differences", "absolute"] = Field(
        "differences", description="fit differences of random rows, or the rows themselves"
    )
    alpha: float = Field(
        1e-3,
        gt=0.0,
        description="L1 strength for scaled features and targets",
        json_schema_extra={"tune": [1e-4, 1e-3, 1e-2]},
    )
    pairs: float = Field(2.0, gt=0.0, description="differences drawn a row")
    iterations: int = Field(1000, ge=1, description="of the solver")


class TreesConfig(BaselineConfig):
    """Options of scikit-learn's forests."""

    scale_inputs: bool = False
    trees: int = Field(100, ge=1, description="number of trees")
    max_features: float | Literal["sqrt"] = Field(
        "sqrt",
        description="features tried at a node: the root of their number, or a share",
        json_schema_extra={"tune": ["sqrt", 0.1, 0.3]},
    )
    min_samples_leaf: int = Field(
        2, ge=1, description="rows a leaf must hold", json_schema_extra={"tune": [1, 2, 5]}
    )
    max_depth: int | None = Field(None, ge=1, description="levels below the root; none = no limit")
    threads: int = Field(0, ge=0, description="threads of a fit; 0 = all cores; same trees for any")


class CnnConfig(BaselineConfig):
    """Options of the convolutional net."""

    prefix: str = "depth64"
    scale_inputs: bool = False
    epochs: int = Field(40, ge=1, description="passes over the rows at most")
    patience: int = Field(6, ge=1, description="passes without progress on held-out roll-outs")
    batch: int = Field(64, ge=1, description="rows a step")
    rate: float = Field(1e-3, gt=0.0, description="step size of Adam")
    decay: float = Field(
        1e-4,
        ge=0.0,
        description="weight decay",
        json_schema_extra={"tune": [1e-4, 1e-3, 1e-2]},
    )
    held_out: float = Field(0.1, gt=0.0, lt=1.0, description="share of roll-outs for stopping")


class DepthConfig(Section):
    """Options of the small depth picture."""

    grasp: bool = Field(True, description="add the six coordinates of the grippers")
    min_pixels: int = Field(100, ge=1, description="fewer measured pixels are no cloth")


class JoinedPart(Section):
    """One extractor of several."""

    plugin: str = Field(description="name of the extractor")
    options: dict[str, Any] = Field({}, description="that extractor's own options")
    prefix: str = Field("", description="put before each of its names; keeps like parts apart")


class JoinedConfig(Section):
    """Options of several extractors in one."""

    parts: list[JoinedPart] = Field(
        [JoinedPart(plugin="how"), JoinedPart(plugin="depth64")],
        min_length=1,
        description="extractors in the order of their features; the first gives the anchor",
    )
