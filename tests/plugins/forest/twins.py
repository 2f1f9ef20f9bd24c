"""Plain numpy twins of the compiled kernels: slow, obvious, and what the kernels must equal."""

from __future__ import annotations

import itertools

import numpy as np
from clothrf_forest.growth import SCALE, entropy_table

MASK = 2**64 - 1
GOLDEN, MIX_A, MIX_B = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def scrambled(state: int) -> int:
    z = ((state ^ (state >> 30)) * MIX_A) & MASK
    z = ((z ^ (z >> 27)) * MIX_B) & MASK
    return z ^ (z >> 31)


def grow_tree(
    codes, labels, num_labels, targets, weights, seed, max_depth, min_gain, node_local,
    max_features, least, always,
):  # fmt: skip
    """As `growth.grow_tree`, from the definition: every cut of every drawn column is scored."""
    table = entropy_table(int(weights.sum(dtype=np.int64)))
    whole = int(weights.sum(dtype=np.int64))
    nodes: list[list[float]] = [[-1, 0, 0, 0.0]]
    leaf = np.empty(codes.shape[1], np.int32)
    leaves = 0
    pending = [(0, 0, np.arange(codes.shape[1]), scrambled(seed))]
    while pending:
        node, depth, rows, state = pending.pop()
        inside = rows[weights[rows] > 0]
        w = weights[inside].astype(np.int64)
        total = int(w.sum())
        best_gain, best = -1.0, None

        def mixed(part, weight):
            return int(table[int(weight.sum())]) - int(
                table[np.bincount(labels[part], weight, num_labels).astype(int)].sum()
            )

        def energy(part, weight):
            s = (weight[:, None] * targets[part]).sum(0)
            return (s * s).sum() / weight.sum()

        if num_labels:
            impurity = mixed(inside, w) / SCALE
        else:
            impurity = (w[:, None] * targets[inside] ** 2).sum() - energy(inside, w)
        if (
            depth < max_depth
            and len(inside) > 1
            and total >= 2 * least
            and impurity > 1e-12 * total
        ):
            drawable = len(codes) - always
            deck = list(range(drawable))
            offered = list(range(drawable, len(codes)))
            tried = seen = 0
            while offered or (seen < drawable and (tried < max_features or best is None)):
                if offered:
                    f = offered.pop(0)
                else:
                    state = (state + GOLDEN) & MASK
                    draw = (scrambled(state) >> 32) & 0xFFFFFFFF
                    j = seen + ((draw * (drawable - seen)) >> 32)
                    deck[seen], deck[j] = deck[j], deck[seen]
                    f = deck[seen]
                    seen += 1
                levels = codes[f, inside]
                present = np.unique(levels).astype(int)
                if len(present) == 1:
                    continue
                tried += f < drawable
                scores = []
                for low, high in itertools.pairwise(present):
                    left = levels <= low
                    if min(w[left].sum(), w[~left].sum()) < least:
                        continue
                    a, b = (inside[left], w[left]), (inside[~left], w[~left])
                    if num_labels:
                        gain = impurity - (mixed(*a) + mixed(*b)) / SCALE
                    else:
                        gain = energy(*a) + energy(*b) - energy(inside, w)
                    scores.append((gain, (low + high) // 2))
                if scores:
                    gain, cut = max(scores, key=lambda s: s[0])
                    if gain > best_gain:
                        best_gain, best = gain, (f, cut)
        best_gain /= total if node_local else whole
        if best is None or best_gain + 2.2e-16 < min_gain:
            nodes[node][2] = leaves
            leaf[rows] = leaves
            leaves += 1
            continue
        f, cut = best
        nodes[node] = [f, cut, len(nodes), best_gain]
        goes_left = codes[f, rows] <= cut
        for side, mix in ((~goes_left, MIX_A), (goes_left, MIX_B)):
            where = len(nodes) + (1 if mix == MIX_A else 0)
            pending.append((where, depth + 1, rows[side], scrambled(state ^ mix)))
        nodes += [[-1, 0, 0, 0.0], [-1, 0, 0, 0.0]]
    column, cut, child, gain = (np.array(c) for c in zip(*nodes, strict=True))
    return column, cut, child, gain, leaf, leaves
