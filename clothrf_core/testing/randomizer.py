"""What every `Randomizer` must do."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from clothrf_core.interfaces import Randomizer
from clothrf_core.params import Randomization
from clothrf_core.types import RgbdFrame


def check_randomizer(
    make: Callable[[], Randomizer],
    nominal: Randomization,
    frame: RgbdFrame,
    *,
    make_zero: Callable[[], Randomizer] | None = None,
) -> None:
    """Same generator, same draw and same frame; inputs stay as they were; strength 0 = identity.

    Args:
        make: builds the randomiser.
        nominal: what it varies.
        frame: a perfect picture with some cloth in it, told the nominal camera.
        make_zero: builds it with all strengths at zero.

    Raises:
        AssertionError: a promise is broken.
    """
    first, second = make(), make()
    before, depth, rgb = dataclasses.replace(nominal), np.array(frame.depth), np.array(frame.rgb)
    for seed in range(8):
        drawn = first.draw(np.random.default_rng(seed), nominal)
        assert same(drawn, second.draw(np.random.default_rng(seed), nominal)), (
            f"seed {seed}: the same generator drew something else"
        )
        for corner in ("hands", "grasp"):
            assert np.array_equal(
                getattr(drawn.simulation, corner), getattr(nominal.simulation, corner)
            ), f"seed {seed}: the start corners '{corner}' belong to the caller, yet they changed"
        _check_frame(first, second, frame, drawn, seed)
    assert same(nominal, before), "drawing changed the nominal randomisation"
    assert np.array_equal(frame.depth, depth, equal_nan=True), "corrupting changed its input depth"
    assert np.array_equal(frame.rgb, rgb), "corrupting changed its input colours"
    if make_zero is not None:
        zero = make_zero()
        drawn = zero.draw(np.random.default_rng(0), nominal)
        for field in dataclasses.fields(Randomization):
            if field.name != "sensor":
                assert same(getattr(drawn, field.name), getattr(nominal, field.name)), (
                    f"strength 0: '{field.name}' is not the nominal one"
                )
        seen = zero.corrupt(frame, drawn, np.random.default_rng(0))
        assert np.array_equal(seen.depth, depth, equal_nan=True), "strength 0: the depth changed"
        assert np.array_equal(seen.rgb, rgb), "strength 0: the colours changed"


def _check_frame(
    first: Randomizer, second: Randomizer, frame: RgbdFrame, drawn: Randomization, seed: int
) -> None:
    first.corrupt(frame, drawn, np.random.default_rng(seed + 1000))  # must leave no trace
    seen = first.corrupt(frame, drawn, np.random.default_rng(seed))
    again = second.corrupt(frame, drawn, np.random.default_rng(seed))
    assert np.array_equal(seen.depth, again.depth, equal_nan=True), (
        f"seed {seed}: the same generator gave another depth picture"
    )
    assert np.array_equal(seen.rgb, again.rgb), f"seed {seed}: the same generator, other colours"
    assert seen.stamp_ns == frame.stamp_ns, f"seed {seed}: the stamp changed"
    assert same(seen.camera, frame.camera), (
        f"seed {seed}: the camera that the policy is told must stay the nominal one"
    )
    measured = seen.depth[np.isfinite(seen.depth)]
    assert not np.isinf(seen.depth).any(), f"seed {seed}: infinite depth; missing depth is NaN"
    assert measured.size == 0 or measured.min() > 0.0, f"seed {seed}: depth behind the camera"


def same(a: Any, b: Any) -> bool:
    """Equality of nouns, arrays, mappings and sequences, NaN equal to NaN."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)
