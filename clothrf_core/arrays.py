"""Checks that every noun runs once, where it is made: shape, dtype, finiteness, read-only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clothrf_core.errors import ShapeError


def checked(
    name: str,
    value: Any,
    shape: tuple[int | None, ...],
    dtype: DTypeLike,
    *,
    finite: bool = False,
) -> NDArray[Any]:
    """A read-only view of `value` after checking it; nothing is cast or copied.

    Args:
        name: what to call the array in the error, for example ``"RgbdFrame.depth"``.
        value: the array.
        shape: expected shape; ``None`` matches any length.
        dtype: expected dtype, exactly.
        finite: also refuse NaN and infinity.

    Raises:
        ShapeError: naming what was expected and what was found.
    """
    wanted = np.dtype(dtype)
    if not isinstance(value, np.ndarray):
        raise ShapeError(
            f"{name}: expected a numpy array {wanted} of shape {_text(shape)}, got "
            f"{type(value).__name__}"
        )
    if value.dtype != wanted or not _fits(value.shape, shape):
        raise ShapeError(
            f"{name}: expected {wanted} of shape {_text(shape)}, got {value.dtype} of shape "
            f"{value.shape}"
        )
    if finite and not np.isfinite(value).all():
        raise ShapeError(f"{name}: expected finite numbers, got NaN or infinity in {_text(shape)}")
    view = value.view()
    view.flags.writeable = False
    return view


def _fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    # A list, not a generator: this runs dozens of times a control step.
    return len(found) == len(wanted) and all(
        [n is None or n == m for n, m in zip(wanted, found, strict=True)]  # noqa: C419
    )


def _text(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("*" if n is None else str(n) for n in shape) + ")"
