"""What the forest costs: one row in the loop, a fit against scikit-learn, a million rows.

The data are smooth low-rank features with noise and actions that follow from six hidden
coordinates, as wrinkles follow from two hands.
"""

from __future__ import annotations

import functools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clothrf_core.provider import Figure
from clothrf_core.types import DatasetView
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest

FEATURES = 768


def row(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    """`forest_row_us`: `act` with 100 trees, checks and confidence included."""
    from sklearn.ensemble import RandomForestRegressor

    from clothrf_forest.answer import EXTRA, answer_in_numpy, prepared
    from clothrf_forest.bench_peers import peers

    view = synthetic_rows(2_000 if quick else 10_000)
    forest = Forest(ForestConfig(trees=100))
    forest.fit(view, np.random.default_rng(0))
    rows = [view.feature_row(i) for i in range(0, len(view), 7)]
    calls = 2_000 if quick else 10_000
    ours = _times([functools.partial(forest.act, r, "straight") for r in rows], calls)

    arrays = prepared(forest.model, 0)
    out = np.empty(6 + EXTRA)
    plain = _times(
        [functools.partial(answer_in_numpy, r.values, r.anchor, arrays, out) for r in rows], 200
    )
    peer = RandomForestRegressor(100, max_features="sqrt", max_depth=20, n_jobs=1, random_state=0)
    peer.fit(view.features, view.labels[:, 0].reshape(len(view), 6))
    theirs = _times([functools.partial(peer.predict, r.values[None]) for r in rows[:50]], 50)
    others = peers(peer, np.stack([r.values for r in rows[:50]]), _times)
    return [
        Figure(
            "forest_row_us",
            statistics.median(ours),
            "us",
            {
                "p99": float(np.quantile(ours, 0.99)),
                "max": max(ours),
                "without_numba_us": statistics.median(plain),
                "sklearn_predict_us": statistics.median(theirs),
                "times_faster_than_sklearn": statistics.median(theirs) / statistics.median(ours),
                "leaves": forest.model.trees.num_leaves,
                **others,
            },
        )
    ]


def train(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    """`train_vs_sklearn`: entropy forests of 64 labels, 768 features, one thread each, CPU time.

    Both get the same rows and labels and hold mean actions in their leaves; the held-out error of
    both stands beside the ratio. The quick form has fewer trees and rows.
    """
    from sklearn.ensemble import RandomForestClassifier

    n, trees = (3_000, 8) if quick else (10_000, 50)
    view, unseen = synthetic_rows(n), synthetic_rows(1_000, seed=1)
    config = ForestConfig.model_validate(
        {
            "trees": trees,
            "topology": "entropy-labels",
            "base": "none",
            "use_anchor": False,
            "bootstrap": "rows",
            "min_impurity_decrease": 1e-4,
            "labels": {"method": "k-means", "clusters": 64},
            "threads": 1,
        }
    )
    forest = Forest(config)
    forest.fit(view.rows(slice(0, 200)), np.random.default_rng(0))  # compile first
    start = time.process_time()
    facts = forest.fit(view, np.random.default_rng(0))
    ours = time.process_time() - start
    answers = [forest.act(unseen.feature_row(i), "straight").targets for i in range(len(unseen))]

    from clothrf_forest.fitting import actions
    from clothrf_forest.labels import label_actions

    targets = actions(view, anchored=True)
    labels = label_actions(targets, config.labels, np.random.default_rng(0)).index
    start = time.process_time()
    peer = RandomForestClassifier(
        trees,
        criterion="entropy",
        max_features="sqrt",
        max_depth=20,
        min_impurity_decrease=1e-4,
        n_jobs=1,
        random_state=0,
    ).fit(view.features, labels)
    theirs = time.process_time() - start
    found = sum(
        _leaf_means(tree, view.features[held], targets[held], unseen.features)
        for tree, held in zip(peer.estimators_, peer.estimators_samples_, strict=True)
    )
    predicted = found / trees + np.tile(unseen.anchors, 2)
    truth = unseen.labels[:, 0].reshape(-1, 6)
    error = float(np.sqrt(((np.array(answers).reshape(-1, 6) - truth) ** 2).mean()))
    peer_error = float(np.sqrt(((predicted - truth) ** 2).mean()))
    return [
        Figure(
            "train_vs_sklearn",
            theirs / ours,
            "ratio",
            {
                "rows": n,
                "trees": trees,
                "ours_cpu_s": ours,
                "sklearn_cpu_s": theirs,
                "ours_rms_mm": 1e3 * error,
                "sklearn_rms_mm": 1e3 * peer_error,
                "ours_leaves_per_tree": facts["leaves_per_tree"],
                "sklearn_leaves_per_tree": statistics.mean(
                    t.get_n_leaves() for t in peer.estimators_
                ),
            },
        )
    ]


def million(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    """`fit_million_rows_gib`: peak memory of a process that fits memory-mapped rows.

    The quick form fits 40,000 and 80,000 rows and extends the line through both.
    """
    trees = 4 if quick else 20
    sizes: tuple[int, ...] = (40_000, 80_000) if quick else (1_000_000,)
    runs = [_fit_in_a_process(n, trees) for n in sizes]
    peak = runs[-1]["gib"]
    if quick:
        peak += (runs[1]["gib"] - runs[0]["gib"]) / (sizes[1] - sizes[0]) * (1_000_000 - sizes[1])
        # Leaf numbers and samples of the 100 trees of the default, 5 bytes a row each.
        peak += 2 * 5 * 1_000_000 * (100 - trees) / 2**30
    detail = {"rows": sizes[-1], "trees": trees, "extrapolated": quick, "fit_s": runs[-1]["fit_s"]}
    return [Figure("fit_million_rows_gib", peak, "GiB", detail)]


def synthetic_rows(n: int, *, seed: int = 0, frames: int = 50) -> DatasetView:
    """Rows of one task like those of the real one: smooth, low rank, noisy, in roll-outs."""
    rng = np.random.default_rng(seed)
    hidden = _hidden(n, frames, rng)
    features, move = _observed(hidden, rng)
    anchors = np.array([0.55, 0.0, 0.35]) + 0.03 * hidden[:, :3]
    return DatasetView(
        features=features,
        names=tuple(f"feature {i}" for i in range(FEATURES)),
        anchors=anchors,
        labels=(anchors[:, None, :] + move)[:, None],
        tasks=("straight",),
        groups=(np.arange(n) // frames).astype(np.int64),
        grasps=np.zeros((n, 2, 3)),
    )


def _hidden(n: int, frames: int, rng: np.random.Generator) -> np.ndarray:
    rollouts = -(-n // frames)
    starts = rng.uniform(-1.0, 1.0, (rollouts, 1, 6))
    ends = rng.uniform(-1.0, 1.0, (rollouts, 1, 6))
    t = np.linspace(0.0, 1.0, frames)[None, :, None]
    path: np.ndarray = (starts + (ends - starts) * t).reshape(-1, 6)[:n]
    return path


def _observed(hidden: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    fixed = np.random.default_rng(123)
    waves = np.cos(hidden @ (0.8 * fixed.normal(size=(6, 40))) + fixed.uniform(0, 6, 40))
    features = waves @ fixed.normal(size=(40, FEATURES)) / np.sqrt(40)
    noisy = np.maximum(features, -0.5) + 0.2 * rng.normal(size=features.shape)
    move = 0.1 * np.tanh(hidden @ fixed.normal(size=(6, 6))).reshape(-1, 2, 3)
    return noisy.astype(np.float32), move


def _leaf_means(
    tree: object, features: np.ndarray, targets: np.ndarray, asked: np.ndarray
) -> np.ndarray:
    leaf = tree.apply(features)  # type: ignore[attr-defined]
    size = int(leaf.max()) + 1
    count = np.maximum(np.bincount(leaf, minlength=size), 1)
    mean = np.stack([np.bincount(leaf, y, size) for y in targets.T], axis=1) / count[:, None]
    found: np.ndarray = mean[tree.apply(asked)]  # type: ignore[attr-defined]
    return found


def _times(calls: list[Callable[[], object]], count: int) -> list[float]:
    """CPU microseconds of `count` calls, after a few that warm up."""
    for i in range(min(count, 20)):
        calls[i % len(calls)]()
    result = []
    for i in range(count):
        start = time.thread_time_ns()
        calls[i % len(calls)]()
        result.append(1e-3 * (time.thread_time_ns() - start))
    return result


def _fit_in_a_process(n: int, trees: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "clothrf_forest.bench", folder, str(n), str(trees)]
        done = subprocess.run(
            command, check=True, capture_output=True, text=True, env={**os.environ}
        )
    result: dict[str, float] = json.loads(done.stdout)
    return result


def _fit_mapped(folder: Path, n: int, trees: int) -> dict[str, float]:
    """Write `n` rows to a file, fit them from there, and say what it took."""
    import resource

    path = folder / "features.npy"
    mapped = np.lib.format.open_memmap(path, "w+", np.float32, (n, FEATURES))
    parts = []
    for start in range(0, n, 10_000):
        part = synthetic_rows(min(10_000, n - start), seed=start)
        mapped[start : start + len(part)] = part.features
        parts.append((part.anchors, part.labels))
    mapped.flush()
    del mapped
    anchors, labels = (np.concatenate(p) for p in zip(*parts, strict=True))
    view = DatasetView(
        features=np.load(path, mmap_mode="r"),
        names=part.names,
        anchors=anchors,
        labels=labels,
        tasks=part.tasks,
        groups=np.arange(n, dtype=np.int64) // 50,
        grasps=np.zeros((n, 2, 3)),
    )
    start_s = time.perf_counter()
    Forest(ForestConfig(trees=trees)).fit(view, np.random.default_rng(0))
    seconds = time.perf_counter() - start_s
    return {"gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, "fit_s": seconds}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_fit_mapped(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))))
