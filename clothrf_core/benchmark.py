"""Runs the measurements that plugins offer and writes them with the machine they were made on."""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothrf_core.errors import ClothrfError, DataError
from clothrf_core.provider import Benchmark, Figure, Setting
from clothrf_core.run_folder import machine


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one benchmark."""

    benchmark: Benchmark
    figures: Sequence[Figure]
    seconds: float
    skipped: str = ""


def run_group(
    benchmarks: Sequence[Benchmark],
    *,
    setting: Setting,
    on_start: Callable[[Benchmark], None] = lambda _: None,
) -> list[Outcome]:
    """Run measurements one after the other; one that cannot run is reported, not fatal."""
    outcomes = []
    for benchmark in benchmarks:
        on_start(benchmark)
        start = time.perf_counter()
        try:
            figures, reason = _measured(benchmark, setting), ""
        except (ClothrfError, ImportError) as error:
            figures, reason = [], f"{error}"
        except Exception as error:  # noqa: BLE001  the other measurements must still be made
            figures, reason = [], f"failed: {type(error).__name__}: {error}"
        outcomes.append(Outcome(benchmark, figures, time.perf_counter() - start, reason))
    return outcomes


def _measured(benchmark: Benchmark, setting: Setting) -> list[Figure]:
    if benchmark.study is not None:
        return benchmark.study(setting)
    return benchmark.run(setting.size == "quick")


def as_json(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """``{"machine": {...}, "figures": {NAME: {"value", "unit", ...}}, "skipped": {...}}``."""
    return {
        "machine": {
            "name": machine(),
            "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        },
        "figures": {
            f.name: {
                "value": plain(f.value),
                "unit": f.unit,
                "detail": {key: plain(value) for key, value in f.detail.items()},
            }
            for o in outcomes
            for f in o.figures
        },
        "skipped": {o.benchmark.name: o.skipped for o in outcomes if o.skipped},
    }


def plain(value: Any) -> Any:
    """A number of numpy as one of Python's, which JSON knows; anything else as it is."""
    return value.item() if isinstance(value, np.generic) else value


def changes(
    new: Mapping[str, Any], old: Mapping[str, Any]
) -> list[tuple[str, float, float, float]]:
    """(name, old, new, new / old) of every figure that both files hold.

    Raises:
        DataError: the old file is not a bench file.
    """
    try:
        before = {k: float(v["value"]) for k, v in old["figures"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"expected a file written by 'clothrf bench --json' ({error})") from error
    rows = []
    for name, figure in new["figures"].items():
        if name in before:
            value = float(figure["value"])
            ratio = value / before[name] if before[name] else float("nan")
            rows.append((name, before[name], value, ratio))
    return rows


def timed(
    call: Callable[[], object], *, repeats: int, warm: int = 3, cpu: bool = True
) -> dict[str, float]:
    """Median, p99 and minimum seconds of `call`, by the thread's CPU clock or the wall's.

    CPU time leaves out what neighbours on a shared machine take; wall time is what a user waits.
    """
    clock = time.thread_time_ns if cpu else time.perf_counter_ns
    for _ in range(warm):
        call()
    spans = []
    for _ in range(repeats):
        start = clock()
        call()
        spans.append((clock() - start) * 1e-9)
    return {
        "median": statistics.median(spans),
        "p99": float(np.percentile(spans, 99)),
        "min": min(spans),
    }
