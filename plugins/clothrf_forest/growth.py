"""Growing one tree on binned features: the hot loop of training.

Splits are sought on histograms of at most 256 levels a feature. The rows of a node are sorted by
level (counting sort) and swept once from left to right while two label histograms and their sums
of c log2 c are kept up to date, so a feature costs O(rows), whatever the number of labels.
c log2 c is a table of 64-bit fixed-point numbers: sums are exact, hence independent of order.

Every node carries its own random state, derived from its parent's: a subtree does not depend on
what happened elsewhere, so a tree stopped earlier is a tree of the same splits, cut back.

Sources: Shannon entropy gain of Shotton et al. (CVPR 2011, eq. 5-6); the stopping rule is
``min_impurity_decrease`` of scikit-learn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

SCALE = 2.0**32
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)
_LOW = np.uint64(0xFFFFFFFF)
_SMALL = 24


def entropy_table(total: int) -> NDArray[np.int64]:
    """(total + 1,) int64 fixed-point c log2 c; 32 fractional bits."""
    c = np.arange(total + 1, dtype=np.float64)
    return np.rint(c * np.log2(np.maximum(c, 1.0)) * SCALE).astype(np.int64)


@njit(cache=True, nogil=True)
def scrambled(state: Any) -> Any:
    """The output function of splitmix64 (Steele, Lea, Flood 2014)."""
    z = (state ^ (state >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@njit(cache=True, nogil=True)
def _sorted_by_level(column: Any, rows: Any, order: Any, levels: Any, start: Any) -> Any:
    """Write `rows` sorted by level (stable) into `order`; True if the level is constant."""
    n = rows.size
    low: Any = 255
    high: Any = 0
    for i in range(n):
        c: Any = np.int64(column[rows[i]])
        levels[i] = c
        low = min(low, c)
        high = max(high, c)
    if low == high:
        return True
    if n <= _SMALL:
        for i in range(n):
            c = levels[i]
            r = rows[i]
            j = i - 1
            while j >= 0 and levels[j] > c:
                levels[j + 1] = levels[j]
                order[j + 1] = order[j]
                j -= 1
            levels[j + 1] = c
            order[j + 1] = r
        return False
    start[low : high + 2] = 0
    for i in range(n):
        start[levels[i] + 1] += 1
    for c in range(low + 1, high + 1):
        start[c + 1] += start[c]
    for i in range(n):
        c = levels[i]
        order[start[c]] = rows[i]
        start[c] += 1
    return False


@njit(cache=True, nogil=True)
def _sweep_labels(
    column: Any, order: Any, n: Any, labels: Any, weights: Any, left: Any, right: Any,
    table: Any, total: Any, s_node: Any, least: Any,
) -> Any:  # fmt: skip
    """Best cut of one sorted feature: (sum of n H over both sides, fixed point; level), or (-1, 0).

    On return the histograms have changed places: all labels stand in `left`, none in `right`.
    """
    best: Any = np.int64(-1)
    cut: Any = 0
    s_left: Any = np.int64(0)
    s_right = s_node
    n_left: Any = 0
    level: Any = np.int64(column[order[0]])
    for i in range(n):
        r = order[i]
        k = labels[r]
        w = np.int64(weights[r])
        a = left[k]
        b = right[k]
        s_left += table[a + w] - table[a]
        s_right += table[b - w] - table[b]
        left[k] = a + w
        right[k] = b - w
        n_left += w
        if i + 1 < n:
            following = np.int64(column[order[i + 1]])
            if following != level:
                n_right = total - n_left
                if n_left >= least and n_right >= least:
                    mixed = table[n_left] - s_left + table[n_right] - s_right
                    if best < 0 or mixed < best:
                        best = mixed
                        cut = (level + following) // 2
                level = following
    return best, cut


@njit(cache=True, nogil=True)
def _sweep_targets(
    column: Any, order: Any, n: Any, targets: Any, weights: Any, sums: Any, part: Any,
    total: Any, least: Any,
) -> Any:  # fmt: skip
    """Best cut of one sorted feature: (sum of |sum y|^2 / n over both sides; level), or (-1, 0)."""
    best = -1.0
    cut: Any = 0
    n_left: Any = 0
    part[:] = 0.0
    level: Any = np.int64(column[order[0]])
    for i in range(n - 1):
        r = order[i]
        w = np.int64(weights[r])
        for d in range(sums.size):
            part[d] += w * targets[r, d]
        n_left += w
        following = np.int64(column[order[i + 1]])
        if following != level:
            n_right = total - n_left
            if n_left >= least and n_right >= least:
                a = 0.0
                b = 0.0
                for d in range(sums.size):
                    a += part[d] * part[d]
                    b += (sums[d] - part[d]) * (sums[d] - part[d])
                between = a / n_left + b / n_right
                if between > best:
                    best = between
                    cut = (level + following) // 2
            level = following
    return best, cut


@njit(cache=True, nogil=True)
def _partitioned(column: Any, cut: Any, rows: Any, spare: Any) -> Any:
    """Stable partition of `rows` in place, level <= cut first; how many those are."""
    k = 0
    m = 0
    for i in range(rows.size):
        r = rows[i]
        if column[r] <= cut:
            rows[k] = r
            k += 1
        else:
            spare[m] = r
            m += 1
    for i in range(m):
        rows[k + i] = spare[i]
    return k


@njit(cache=True, nogil=True)
def grow_tree(
    codes: Any, labels: Any, num_labels: Any, targets: Any, weights: Any, table: Any, seed: Any,
    max_depth: Any, min_gain: Any, node_local: Any, max_features: Any, least: Any,
    always: Any,
) -> Any:  # fmt: skip
    """One tree.

    Args:
        codes: (C, N) uint8 level of every column of every row.
        labels: (N,) int32 below `num_labels`; ignored when `num_labels` is 0.
        num_labels: 0 chooses variance reduction of `targets`.
        targets: (N, D) float64; ignored by label entropy.
        weights: (N,) uint8, how often the row is in the tree's sample; 0 = out of bag.
        table: `entropy_table` of at least the sum of weights.
        seed: uint64.
        max_depth: levels below the root.
        min_gain: least impurity decrease of a split.
        node_local: do not weigh the decrease by the node's share of the sample.
        max_features: non-constant columns tried at a node.
        least: sample rows a leaf must hold.
        always: the last so many columns are tried at every node, besides the drawn ones.

    Returns:
        column (M,) int32, -1 at leaves; cut (M,) uint8, level <= cut goes left; child (M,) int32,
        left child (the right one follows it), or the leaf's number; gain (M,) float64 of the split;
        leaf (N,) int32 of every row, in bag or not; number of leaves.
    """
    num_columns, num_rows = codes.shape
    drawable = num_columns - always
    inside = 0
    for r in range(num_rows):
        if weights[r] > 0:
            inside += 1
    bag = np.empty(inside, np.int32)
    rest = np.empty(num_rows - inside, np.int32)
    a = 0
    b = 0
    whole = np.int64(0)
    for r in range(num_rows):
        if weights[r] > 0:
            bag[a] = r
            a += 1
            whole += weights[r]
        else:
            rest[b] = r
            b += 1

    room = 2 * inside + 1
    column = np.full(room, -1, np.int32)
    cut = np.zeros(room, np.uint8)
    child = np.zeros(room, np.int32)
    gain = np.zeros(room)
    leaf = np.empty(num_rows, np.int32)
    order = np.empty(inside, np.int32)
    levels = np.empty(inside, np.int64)
    spare = np.empty(max(inside, num_rows - inside), np.int32)
    start = np.empty(258, np.int64)
    left = np.zeros(max(num_labels, 1), np.int64)
    right = np.zeros(max(num_labels, 1), np.int64)
    sums = np.zeros(targets.shape[1])
    part = np.zeros(targets.shape[1])
    deck = np.arange(num_columns)
    drawn = np.zeros(num_columns, np.int64)

    # Pending nodes: number, depth, bag range, out-of-bag range; and their random states.
    pending = np.empty((2 * max_depth + 4, 6), np.int64)
    states = np.empty(2 * max_depth + 4, np.uint64)
    pending[0] = (0, 0, 0, inside, 0, num_rows - inside)
    states[0] = scrambled(seed)
    height = 1
    nodes = 1
    leaves = 0
    while height > 0:
        height -= 1
        node, depth, i0, i1, o0, o1 = pending[height]
        state = states[height]
        rows = bag[i0:i1]
        n = i1 - i0
        total = np.int64(0)
        s_node = np.int64(0)
        energy = 0.0
        if num_labels > 0:
            for i in range(n):
                r = rows[i]
                total += weights[r]
                right[labels[r]] += weights[r]
            for i in range(n):
                k = labels[rows[i]]
                if right[k] > 0 and left[k] == 0:
                    left[k] = 1
                    s_node += table[right[k]]
            for i in range(n):
                left[labels[rows[i]]] = 0
            impurity = (table[total] - s_node) / SCALE
        else:
            sums[:] = 0.0
            square = 0.0
            for i in range(n):
                r = rows[i]
                w = np.int64(weights[r])
                total += w
                for d in range(sums.size):
                    sums[d] += w * targets[r, d]
                    square += w * targets[r, d] * targets[r, d]
            for d in range(sums.size):
                energy += sums[d] * sums[d]
            energy /= total
            impurity = square - energy

        best_column = -1
        best_cut = 0
        best_gain = -1.0
        if depth < max_depth and n > 1 and total >= 2 * least and impurity > 1e-12 * total:
            tried = 0
            seen = 0
            offered = 0
            while offered < always or (
                seen < drawable and (tried < max_features or best_column < 0)
            ):
                if offered < always:
                    f = drawable + offered
                    offered += 1
                else:
                    state += _GOLDEN
                    draw = (scrambled(state) >> _S32) & _LOW
                    j = seen + np.int64((draw * np.uint64(drawable - seen)) >> _S32)
                    f = deck[j]
                    deck[j] = deck[seen]
                    deck[seen] = f
                    drawn[seen] = j
                    seen += 1
                values = codes[f]
                if _sorted_by_level(values, rows, order, levels, start):
                    continue
                if f < drawable:
                    tried += 1
                if num_labels > 0:
                    mixed, c = _sweep_labels(
                        values, order, n, labels, weights, left, right, table, total, s_node, least
                    )
                    left, right = right, left
                    found = impurity - mixed / SCALE if mixed >= 0 else -1.0
                else:
                    between, c = _sweep_targets(
                        values, order, n, targets, weights, sums, part, total, least
                    )
                    found = between - energy
                if found > best_gain:
                    best_gain = found
                    best_column = f
                    best_cut = c
            # The deck must not remember: the draws of a node depend on its own state alone.
            for i in range(seen - 1, -1, -1):
                f = deck[i]
                deck[i] = deck[drawn[i]]
                deck[drawn[i]] = f
        if num_labels > 0:
            for i in range(n):
                right[labels[rows[i]]] = 0
        best_gain /= total if node_local else whole
        if best_column < 0 or best_gain + 2.2e-16 < min_gain:
            child[node] = leaves
            for i in range(n):
                leaf[rows[i]] = leaves
            for i in range(o0, o1):
                leaf[rest[i]] = leaves
            leaves += 1
            continue
        values = codes[best_column]
        i_mid = i0 + _partitioned(values, best_cut, rows, spare)
        o_mid = o0 + _partitioned(values, best_cut, rest[o0:o1], spare)
        column[node] = best_column
        cut[node] = best_cut
        child[node] = nodes
        gain[node] = best_gain
        pending[height] = (nodes + 1, depth + 1, i_mid, i1, o_mid, o1)
        states[height] = scrambled(state ^ _MIX_A)
        pending[height + 1] = (nodes, depth + 1, i0, i_mid, o0, o_mid)
        states[height + 1] = scrambled(state ^ _MIX_B)
        height += 2
        nodes += 2
    return (
        column[:nodes].copy(),
        cut[:nodes].copy(),
        child[:nodes].copy(),
        gain[:nodes].copy(),
        leaf,
        leaves,
    )
