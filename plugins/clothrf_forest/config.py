"""What can be set about the forest; every default is the most accurate of the tried ones."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clothrf_core.rig import Section


class LabelsConfig(Section):
    """How actions become the class labels that entropy trees separate."""

    method: Literal["mean-shift", "k-means"] = Field(
        "mean-shift", description="the paper clusters optimal actions by mean shift"
    )
    bandwidth: float = Field(0.05, gt=0.0, description="radius of the flat kernel, m")
    min_points: int = Field(5, ge=1, description="smaller clusters join the nearest larger one")
    minimum: int = Field(
        20, ge=2, description="the bandwidth is halved until there are this many labels"
    )
    clusters: int = Field(0, ge=0, description="k of k-means; 0 = max(minimum, rows / 30)")
    sample: int = Field(2000, ge=50, description="rows that cluster centres are sought among")


class ConfidenceConfig(Section):
    """What `Action.confidence` promises."""

    tolerance: float = Field(
        0.02, gt=0.0, description="confidence = P(RMS error per coordinate < this), m"
    )
    novelty: bool = Field(True, description="confidence falls to 0 on pictures unlike all trained")
    components: int = Field(128, ge=1, le=256, description="principal directions of the novelty")
    quantile: float = Field(
        0.98, gt=0.5, lt=1.0, description="share of held-out rows that must not look novel"
    )


class ForestConfig(Section):
    """The random forest controller.

    The paper's own setting: ``trees = 10``, ``topology = "entropy-labels"``, ``base = "none"``,
    ``leaves = "mean"``, ``target_frame = "world"``, ``min_impurity_decrease = 1e-4``,
    ``use_anchor = false``, ``bootstrap = "rows"``,.
    """

    trees: int = Field(100, ge=1, description="K, number of trees")
    topology: Literal["entropy-labels", "variance"] = Field(
        "variance",
        description="what splits a node: entropy of action labels, or variance of the targets",
    )
    base: Literal["none", "ridge", "quadratic"] = Field(
        "quadratic",
        description="a smooth model whose residual the leaves learn: linear in the features "
        "(ridge), or also in the products of their main directions; or none",
    )
    curve_directions: int = Field(
        32,
        ge=1,
        le=64,
        description="directions, those the actions depend on most, in the products of a "
        "quadratic base",
    )
    leaves: Literal["mean", "refined", "linear"] = Field(
        "linear",
        description="mean action of the leaf (the paper), joint regularised least squares, or a "
        "ridge regression in every leaf on the oblique directions (needs them; else the mean)",
    )
    leaf_penalty: float = Field(
        0.05, gt=0.0, description="of linear leaves, in units of the directions' variance"
    )
    target_frame: Literal["anchor", "world"] = Field(
        "anchor", description="targets relative to the anchor of the picture, or absolute"
    )
    use_anchor: bool = Field(True, description="the anchor's place is three more features")
    oblique: bool = Field(
        True, description="offer the directions of the linear base's answers to every split"
    )
    max_depth: int = Field(20, ge=1, le=64, description="levels below the root")
    min_impurity_decrease: float | Literal["oob"] = Field(
        2e-3,
        description="a split must gain this much (bits, or share of the variance); "
        "oob = the value of a ladder with the least out-of-bag error",
    )
    gain_mode: Literal["sklearn_weighted", "node_local"] = Field(
        "sklearn_weighted", description="weigh the gain by the node's share of all rows, or not"
    )
    min_samples_leaf: int = Field(
        0, ge=0, description="rows a leaf must hold; 0 = 20 for linear leaves, 1 for the others"
    )
    max_features: int | Literal["sqrt"] = Field(
        "sqrt", description="features tried at a node; sqrt = rounded root of their number"
    )
    bootstrap: Literal["rows", "groups", "none"] = Field(
        "groups", description="what a tree's sample is drawn of: rows, whole roll-outs, or all rows"
    )
    subsample: float = Field(1.0, gt=0.0, le=1.0, description="drawn share of rows or groups")
    pairs: int = Field(0, ge=0, description="two-pixel features s_i - s_j offered to the splits")
    labels: LabelsConfig = LabelsConfig()
    confidence: ConfidenceConfig = ConfidenceConfig()
    engine: Literal["auto", "numba", "scikit-learn"] = Field(
        "auto", description="what grows the trees; auto = numba where it is installed"
    )
    threads: int = Field(0, ge=0, description="threads of a fit; 0 = all cores; same trees for any")

    def stored(self) -> dict[str, object]:
        """The settings that shape the result, for the policy file."""
        return self.model_dump(mode="json", exclude={"threads"})
