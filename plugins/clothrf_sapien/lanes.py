"""The inner loops of the banded Cholesky, written for vector registers.

LLVM does not find the register blocking of a small matrix product by itself (a plain numba loop
reached 0.41 ms for the 1512 x 1512 matrix of a 21 x 24 cloth, LAPACK's `spbtrf` 0.52 ms, this file
with `banded` 0.15 ms on the same core), so the four loops that matter are given to it as vectors
of eight float32. LLVM splits the vectors where the machine's registers are narrower, and fuses
multiplication and addition where it can.

All arrays are flat float32 arrays in the layout of `banded`; offsets count elements.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils as _cgutils
from numba.extending import intrinsic

cgutils: Any = _cgutils
LANES = 8
FLOAT = ir.FloatType()
INT = ir.IntType(64)
VECTOR = ir.VectorType(FLOAT, LANES)
FUSE = ("contract",)


def _int(value: int) -> Any:
    return ir.Constant(INT, value)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Pointer to the first element of an array."""
    return cgutils.create_struct_proxy(kind)(context, builder, value=value).data


def _load(builder: Any, base: Any, offset: Any) -> Any:
    pointer = builder.bitcast(builder.gep(base, [offset]), VECTOR.as_pointer())
    value = builder.load(pointer)
    value.align = 4
    return value


def _store(builder: Any, value: Any, base: Any, offset: Any) -> None:
    pointer = builder.bitcast(builder.gep(base, [offset]), VECTOR.as_pointer())
    builder.store(value, pointer).align = 4


def _spread(builder: Any, scalar: Any) -> Any:
    """A vector of eight times the same number."""
    nothing = ir.Constant(VECTOR, ir.Undefined)
    one = builder.insert_element(nothing, scalar, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, nothing, mask)


def _less(builder: Any, value: Any, factor: Any, other: Any) -> Any:
    """``value - factor * other``."""
    return builder.fsub(value, builder.fmul(factor, other, flags=FUSE), flags=FUSE)


def _lane(builder: Any, vector: Any, lane: int) -> Any:
    return builder.extract_element(vector, ir.Constant(ir.IntType(32), lane))


def _subtract_products(
    typing: Any, A: Any, S: Any, to: Any, rows: Any, factors: Any, panels: Any
) -> Any:
    """Subtract from a tile of 16 rows x 4 columns what `panels` earlier panels contribute.

    ``A[to + j S + i] -= sum over panels J and columns k of A[rows + i] A[factors + j]``, where
    `rows` and `factors` move by S from column to column and by 8 S - 8 from panel to panel. The
    tile stays in eight registers.
    """
    integer = types.int64
    signature = types.void(A, integer, integer, integer, integer, integer)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _data(context, builder, sig.args[0], args[0])
        stride, target, row, factor, count = args[1:]
        tile = [[cgutils.alloca_once(builder, VECTOR) for _ in range(2)] for _ in range(4)]
        at = target
        for j in range(4):
            for i in range(2):
                builder.store(_load(builder, base, builder.add(at, _int(8 * i))), tile[j][i])
            at = builder.add(at, stride)
        step = builder.sub(builder.mul(stride, _int(8)), _int(8))
        with cgutils.for_range(builder, count) as loop:
            moved = builder.mul(loop.index, step)
            r, f = builder.add(row, moved), builder.add(factor, moved)
            for _ in range(8):
                column = [_load(builder, base, builder.add(r, _int(8 * i))) for i in range(2)]
                for j in range(4):
                    scalar = builder.load(builder.gep(base, [builder.add(f, _int(j))]))
                    spread = _spread(builder, scalar)
                    for i in range(2):
                        old = builder.load(tile[j][i])
                        builder.store(_less(builder, old, spread, column[i]), tile[j][i])
                r, f = builder.add(r, stride), builder.add(f, stride)
        at = target
        for j in range(4):
            for i in range(2):
                _store(builder, builder.load(tile[j][i]), base, builder.add(at, _int(8 * i)))
            at = builder.add(at, stride)
        return context.get_dummy_value()

    return signature, generate


def _factor_panel(typing: Any, A: Any, S: Any, at: Any, blocks: Any) -> Any:
    """Cholesky of one panel: its 8 x 8 triangle, then the `blocks` of eight rows below it.

    The diagonal is left as its inverse. A pivot that is not above 1e-12 is taken for 1e12. The
    roots are taken when the triangle is done (L D L^T first): each would hold up the next pivot.
    """
    integer = types.int64
    signature = types.void(A, integer, integer, integer)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _data(context, builder, sig.args[0], args[0])
        stride, start, count = args[1:]
        root = builder.module.declare_intrinsic("llvm.sqrt", [FLOAT])
        starts = [builder.add(start, builder.mul(stride, _int(k))) for k in range(8)]
        columns = [_load(builder, base, starts[k]) for k in range(8)]
        zero = ir.Constant(VECTOR, [0.0] * LANES)
        inverses = []
        for k in range(8):
            pivot = _lane(builder, columns[k], k)
            good = builder.fcmp_ordered(">", pivot, ir.Constant(FLOAT, 1e-12))
            pivot = builder.select(good, pivot, ir.Constant(FLOAT, 1e12))
            inverse = builder.fdiv(ir.Constant(FLOAT, 1.0), pivot)
            inverses.append(builder.call(root, [inverse]))
            scaled = builder.fmul(columns[k], _spread(builder, inverse))
            for j in range(k + 1, 8):
                factor = _spread(builder, _lane(builder, scaled, j))
                columns[j] = _less(builder, columns[j], factor, columns[k])
        for k in range(8):
            columns[k] = builder.fmul(columns[k], _spread(builder, inverses[k]))
        for k in range(8):
            below = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [i > k for i in range(LANES)])
            kept = builder.select(below, columns[k], zero)
            lane = ir.Constant(ir.IntType(32), k)
            kept = builder.insert_element(kept, inverses[k], lane)
            _store(builder, kept, base, starts[k])
        with cgutils.for_range(builder, count) as loop:
            shift = builder.mul(builder.add(loop.index, _int(1)), _int(8))
            places = [builder.add(starts[k], shift) for k in range(8)]
            block = [_load(builder, base, places[k]) for k in range(8)]
            for k in range(8):

                def number(j: int, k: int = k) -> Any:
                    where = builder.add(starts[k], _int(j))
                    return _spread(builder, builder.load(builder.gep(base, [where])))

                block[k] = builder.fmul(block[k], number(k))
                for j in range(k + 1, 8):
                    block[j] = _less(builder, block[j], number(j), block[k])
            for k in range(8):
                _store(builder, block[k], base, places[k])
        return context.get_dummy_value()

    return signature, generate


def _forward_panel(typing: Any, A: Any, S: Any, at: Any, blocks: Any, x: Any, row: Any) -> Any:
    """One panel of ``L y = x``: eight unknowns from `row` on, then the right-hand side below."""
    integer = types.int64
    signature = types.void(A, integer, integer, integer, x, integer)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _data(context, builder, sig.args[0], args[0])
        vector = _data(context, builder, sig.args[4], args[4])
        stride, start, count = args[1:4]
        first = args[5]
        starts = [builder.add(start, builder.mul(stride, _int(k))) for k in range(8)]
        places = [builder.gep(vector, [builder.add(first, _int(k))]) for k in range(8)]
        values = [builder.load(p) for p in places]
        for k in range(8):
            inverse = builder.load(builder.gep(base, [builder.add(starts[k], _int(k))]))
            values[k] = builder.fmul(values[k], inverse)
            for j in range(k + 1, 8):
                factor = builder.load(builder.gep(base, [builder.add(starts[k], _int(j))]))
                values[j] = _less(builder, values[j], factor, values[k])
        for k in range(8):
            builder.store(values[k], places[k])
        spread = [_spread(builder, v) for v in values]
        with cgutils.for_range(builder, count) as loop:
            shift = builder.mul(builder.add(loop.index, _int(1)), _int(8))
            target = builder.add(first, shift)
            total = _load(builder, vector, target)
            for k in range(8):
                column = _load(builder, base, builder.add(starts[k], shift))
                total = _less(builder, total, spread[k], column)
            _store(builder, total, vector, target)
        return context.get_dummy_value()

    return signature, generate


def _backward_panel(typing: Any, A: Any, S: Any, at: Any, blocks: Any, x: Any, row: Any) -> Any:
    """One panel of ``L^T x = y``: eight unknowns from `row` on, from those below."""
    integer = types.int64
    signature = types.void(A, integer, integer, integer, x, integer)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        base = _data(context, builder, sig.args[0], args[0])
        vector = _data(context, builder, sig.args[4], args[4])
        stride, start, count = args[1:4]
        first = args[5]
        kind = ir.FunctionType(FLOAT, [FLOAT, VECTOR])
        reduce = cgutils.get_or_insert_function(
            builder.module, kind, "llvm.vector.reduce.fadd.v8f32"
        )
        starts = [builder.add(start, builder.mul(stride, _int(k))) for k in range(8)]
        zero = ir.Constant(VECTOR, [0.0] * LANES)
        sums = [cgutils.alloca_once(builder, VECTOR) for _ in range(8)]
        for total in sums:
            builder.store(zero, total)
        with cgutils.for_range(builder, count) as loop:
            shift = builder.mul(builder.add(loop.index, _int(1)), _int(8))
            known = _load(builder, vector, builder.add(first, shift))
            for k in range(8):
                column = _load(builder, base, builder.add(starts[k], shift))
                builder.store(_less(builder, builder.load(sums[k]), column, known), sums[k])
        places = [builder.gep(vector, [builder.add(first, _int(k))]) for k in range(8)]
        values: list[Any] = []
        for k in range(8):
            # reassoc: the eight lanes are added as a tree
            total = builder.call(
                reduce, [builder.load(places[k]), builder.load(sums[k])], fastmath=("reassoc",)
            )
            values.append(total)
        for k in range(7, -1, -1):
            for j in range(k + 1, 8):
                factor = builder.load(builder.gep(base, [builder.add(starts[k], _int(j))]))
                values[k] = _less(builder, values[k], factor, values[j])
            inverse = builder.load(builder.gep(base, [builder.add(starts[k], _int(k))]))
            values[k] = builder.fmul(values[k], inverse)
            builder.store(values[k], places[k])
        return context.get_dummy_value()

    return signature, generate


subtract_products: Any = intrinsic(_subtract_products)
factor_panel: Any = intrinsic(_factor_panel)
forward_panel: Any = intrinsic(_forward_panel)
backward_panel: Any = intrinsic(_backward_panel)
