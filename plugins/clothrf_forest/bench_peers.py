"""Other engines that answer one row of scikit-learn's forest; each is optional."""

from __future__ import annotations

import functools
import statistics
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from clothrf_core.types import Float32

Answer = Callable[[Float32], Any]


def peers(forest: Any, rows: Float32, times: Callable[..., Sequence[float]]) -> Mapping[str, Any]:
    """Median microseconds a row of each engine at hand, or why it is not: ``NAME_us``, ``NAME``.

    Args:
        forest: a fitted `sklearn.ensemble.RandomForestRegressor`.
        rows: (N, F) float32.
        times: measures calls, microseconds.
    """
    found: dict[str, Any] = {}
    wanted = forest.predict(rows[:1])
    for name, make in (("onnxruntime", _onnx), ("treelite", _treelite)):
        try:
            answer = make(forest, rows.shape[1])
        except ImportError as error:
            found[name] = f"skipped: {error}"
            continue
        got = np.asarray(answer(rows[:1])).reshape(wanted.shape)
        np.testing.assert_allclose(got, wanted, atol=1e-3)
        calls = [functools.partial(answer, row[None]) for row in rows]
        found[f"{name}_us"] = statistics.median(times(calls, 4 * len(calls)))
    return found


def _onnx(forest: Any, features: int) -> Answer:
    """ONNX Runtime on one thread."""
    onnxruntime, skl2onnx = import_module("onnxruntime"), import_module("skl2onnx")
    kind = import_module("skl2onnx.common.data_types").FloatTensorType([None, features])
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # its shape warning would be timed too
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = skl2onnx.convert_sklearn(forest, initial_types=[("x", kind)]).SerializeToString()
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    return lambda row: session.run(None, {"x": row})[0]


def _treelite(forest: Any, features: int) -> Answer:
    """Treelite's own interpreter, GTIL, on one thread; nothing is compiled to C."""
    del features
    treelite = import_module("treelite")
    model = treelite.sklearn.import_model(forest)
    return lambda row: treelite.gtil.predict(model, row, nthread=1)
