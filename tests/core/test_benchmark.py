"""What a benchmark measured reaches its file, whatever numbers it was told in."""

import json

import numpy as np

from clothrf_core.benchmark import Outcome, as_json
from clothrf_core.files import json_bytes
from clothrf_core.provider import Benchmark, Figure


def test_numbers_of_numpy_are_written_as_numbers():
    figure = Figure("x", np.float64(1.5), "ms", {"rows": np.int64(3), "peer": "none"})
    outcome = Outcome(Benchmark("core", "b", lambda _: [figure]), [figure], 0.1, "")

    written = json.loads(json_bytes(as_json([outcome])))

    assert written["figures"]["x"] == {
        "value": 1.5,
        "unit": "ms",
        "detail": {"rows": 3, "peer": "none"},
    }
