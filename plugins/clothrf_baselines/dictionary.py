"""The visual feedback dictionary with sparse words (Jia, Hu, Pan, Manocha 2018).

The dictionary holds pairs of a change of features and the change of the action that goes with it.
A word, the difference between the picture and a reference, is written as a sparse mix of atoms,
``min_b |s - D b|^2 / 2 + alpha |b|_1``; the answer is the same mix of their actions.
"""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from clothrf_baselines.config import DictionaryConfig
from clothrf_baselines.method import Arrays, Fitted, Method, Predictor, Rows, held_out
from clothrf_core.types import Float, Float32

_LADDER = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)
_TESTED = 100
# The solver stops when no weight moves by more than this share of the largest.
_SETTLED = 1e-4


class SparseDictionary(Method):
    """Atoms are k-means centres relative to the mean row; the reference is the mean row."""

    @override
    def fit(self, rows: Rows, config: DictionaryConfig, rng: np.random.Generator) -> Fitted:
        alpha = config.alpha
        metrics = {}
        if alpha is None:
            train, test = held_out(rows.groups, 0.2, rng)
            trial = _atoms(rows.x[train], rows.y[train], config.atoms, rng)
            test = rng.permutation(test)[:_TESTED]
            errors = [_error(trial, rows.x[test], rows.y[test], a, config) for a in _LADDER]
            alpha = _LADDER[int(np.argmin(errors))]
            metrics["held_out_error"] = min(errors)
        arrays = _atoms(rows.x, rows.y, config.atoms, rng)
        metrics |= {"atoms": float(len(arrays["atoms"])), "alpha": alpha}
        return Fitted({**arrays, "alpha": np.array(alpha)}, metrics)

    @override
    def predictor(self, arrays: Arrays, config: DictionaryConfig) -> Predictor:
        return _answerer(arrays, float(arrays["alpha"]), config)


def sparse_word(
    atoms: Float32, word: Float32, alpha: float, *, working_set: int, iterations: int
) -> tuple[np.ndarray, Float32]:
    """Indices and weights of the sparse mix of `atoms` (M, f) that is nearest to `word` (f,).

    FISTA (Beck, Teboulle 2009) on the `working_set` atoms that correlate most with the word;
    `alpha` is the L1 strength as a share of the largest correlation, at which the mix is empty.
    """
    correlation = atoms @ word
    count = min(working_set, len(atoms))
    chosen = np.sort(np.argpartition(-np.abs(correlation), count - 1)[:count])
    offered, target = atoms[chosen], correlation[chosen]
    gram = offered @ offered.T
    strength = np.float32(alpha * np.abs(target).max())
    # The largest row sum bounds the largest eigenvalue.
    rate = np.float32(1.0 / max(float(np.abs(gram).sum(axis=1).max()), 1e-12))
    threshold = rate * strength
    mix: Float32 = np.zeros(count, np.float32)
    ahead: Float32 = mix
    momentum = 1.0
    for index in range(iterations):
        moved = ahead - rate * (gram @ ahead - target)
        # Soft threshold.
        following: Float32 = (moved - np.clip(moved, -threshold, threshold)).astype(np.float32)
        further = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
        ahead = following + np.float32((momentum - 1.0) / further) * (following - mix)
        settled = index % 8 == 7 and np.abs(following - mix).max() <= _SETTLED * np.abs(mix).max()
        mix, momentum = following, further
        if settled:
            break
    return chosen, mix


def _answerer(arrays: Arrays, alpha: float, config: DictionaryConfig) -> Predictor:
    atoms, actions = arrays["atoms"], arrays["actions"]
    reference, offset = arrays["reference"], arrays["offset"]
    if len(atoms) != len(actions) or atoms.shape[1:] != reference.shape:
        raise ValueError(f"atoms {atoms.shape}, actions {actions.shape}")

    def answer(x: Float32) -> Float:
        chosen, mix = sparse_word(
            atoms,
            x - reference,
            alpha,
            working_set=config.working_set,
            iterations=config.iterations,
        )
        result: Float = offset + mix @ actions[chosen]
        return result

    return answer


def _error(trial: Arrays, x: Float32, y: Float, alpha: float, config: DictionaryConfig) -> float:
    answer = _answerer(trial, alpha, config)
    answers = np.stack([np.asarray(answer(row)) for row in x])
    return float(np.mean((answers - y) ** 2))


def _atoms(x: Float32, y: Float, most: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Centres relative to the mean, of unit length, and the actions that go with them."""
    reference, offset = x.mean(axis=0), y.mean(axis=0)
    centres, answers = _centres(x, y, most, rng)
    change, action = centres - reference, answers - offset
    length = np.linalg.norm(change, axis=1)
    kept = length > 1e-6 * max(float(length.max()), 1e-12)
    scale = length[kept][:, None]
    return {
        "atoms": (change[kept] / scale).astype(np.float32),
        "actions": action[kept] / scale,
        "reference": reference,
        "offset": offset,
    }


def _centres(
    x: Float32, y: Float, most: int, rng: np.random.Generator, *, rounds: int = 4
) -> tuple[Float32, Float]:
    """k-means centres of the rows (Lloyd, a few rounds) and the mean answer of each."""
    if len(x) <= most:
        return x, y
    centres = x[np.sort(rng.choice(len(x), size=most, replace=False))]
    nearest = np.zeros(len(x), np.intp)
    for _ in range(rounds):
        half = 0.5 * np.sum(centres**2, axis=1)
        for start in range(0, len(x), 4096):
            part = slice(start, start + 4096)
            nearest[part] = np.argmin(half - x[part] @ centres.T, axis=1)
        counts = np.bincount(nearest, minlength=most)
        order = np.argsort(nearest, kind="stable")
        filled = np.flatnonzero(counts)
        starts = np.concatenate([[0], np.cumsum(counts[filled])[:-1]])
        sums = np.add.reduceat(x[order], starts, axis=0)
        centres = (sums / counts[filled][:, None]).astype(np.float32)
        answers = np.add.reduceat(y[order], starts, axis=0) / counts[filled][:, None]
        most = len(centres)
    return centres, answers
