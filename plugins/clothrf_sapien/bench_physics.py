"""What `clothrf bench` measures about the cloth: time, strain, truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from clothrf_core.params import SimulationParams
from clothrf_core.provider import Figure
from clothrf_core.types import ClothMesh, Float
from clothrf_sapien.bench_motions import STEP, TASKS, motion
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.simulator import ClothBatch, ClothSimulator
from clothrf_sapien.truths import cantilever_error, catenary_error, hanging_elongation

SIZES = ((21, 24), (42, 48), (71, 71), (100, 100))


def step(*, quick: bool) -> list[Figure]:
    """Processor time of a control step: many cloths a call, one cloth a call, larger cloths."""
    steps = 60 if quick else 400
    alone = {task: _one(task, steps) for task in TASKS}
    together = amortised("all", steps)
    detail = {f"one_cloth_{task}_ms": float(np.median(t) * 1e3) for task, t in alone.items()}
    detail |= {
        "mean_ms": float(together.mean() * 1e3),
        "p99_ms": float(np.quantile(together, 0.99) * 1e3),
        "max_ms": float(together.max() * 1e3),
        "two_threads_speedup": _threads(steps),
        "vertices": 21 * 24,
    }
    for size in SIZES[: 2 if quick else 4]:
        seconds = np.median(_one("bent", 20 if quick else 60, resolution=size))
        detail[f"us_a_vertex_{size[0]}x{size[1]}"] = float(seconds * 1e6 / (size[0] * size[1]))
    return [Figure("cloth_step_ms", float(np.median(together) * 1e3), "ms", detail)]


def strain(*, quick: bool) -> list[Figure]:
    """Edge strain while the corners are feasible, worst of the tasks and the stress motion."""
    steps = 200 if quick else 2000
    detail: dict[str, float] = {}
    worst = 0.0
    for task in TASKS:
        hands, grasp = motion(task, steps, seed=1)
        simulator = ClothSimulator(ClothOptions())
        state = simulator.reset(np.random.default_rng(1), _params(hands[0], grasp[0]))
        found = []
        for h, g in zip(hands[1:], grasp[1:], strict=True):
            state = simulator.step(g, h, STEP)
            if state.feasible:
                found.append(strains(state.vertices, simulator.mesh()))
        p999 = float(np.quantile(np.abs(found), 0.999))
        worst = max(worst, p999)
        detail |= {
            f"{task}_p999": p999,
            f"{task}_max": float(np.max(np.abs(found))),
            f"{task}_feasible_share": len(found) / (steps - 1),
        }
    detail["rest_speed_mm_s"] = _rest_speed()
    return [Figure("cloth_strain_p999", worst, "1", detail)]


def truth(*, quick: bool) -> list[Figure]:
    """Catenary, cantilever and hanging sheet against their analytic shapes."""
    hanging = {f"hanging_{k:g}_N_m": hanging_elongation(k) for k in (50.0, 1000.0)}
    bending = (1e-3,) if quick else (5e-3, 1e-3, 2e-4)
    cantilever = {f"at_{b:g}_N_m": cantilever_error(bending=b) for b in bending}
    return [
        Figure("cloth_catenary_error", catenary_error(), "1", hanging),
        Figure("cloth_cantilever_error", max(cantilever.values()), "1", cantilever),
    ]


def strains(vertices: Float, mesh: ClothMesh) -> Float:
    """(E,) relative elongation of the reported edges."""
    i, j = mesh.edges.T
    now = np.linalg.norm(vertices[i] - vertices[j], axis=1)
    result: Float = now / np.linalg.norm(mesh.rest[i] - mesh.rest[j], axis=1) - 1.0
    return result


def _params(hands: Float, grasp: Float, **changes: object) -> SimulationParams:
    return SimulationParams(hands=hands, grasp=grasp, **changes)  # type: ignore[arg-type]


def _one(task: str, steps: int, **changes: object) -> Float:
    """(steps,) processor seconds of each control step of one cloth."""
    hands, grasp = motion(task, steps + 1, seed=2)
    simulator = ClothSimulator(ClothOptions())
    simulator.reset(np.random.default_rng(2), _params(hands[0], grasp[0], **changes))
    times = np.zeros(steps)
    for i in range(steps):
        begin = time.thread_time()
        simulator.step(grasp[i + 1], hands[i + 1], STEP)
        times[i] = time.thread_time() - begin
    return times


def _batch(tasks: Sequence[str], steps: int, seed: int) -> tuple[ClothBatch, Float, Float]:
    """A cloth for each of `tasks` and (steps + 1, N, 2, 3) hands and grasps."""
    paths = [motion(task, steps + 1, seed + k) for k, task in enumerate(tasks)]
    hands = np.stack([p[0] for p in paths], axis=1)
    grasp = np.stack([p[1] for p in paths], axis=1)
    batch = ClothBatch(ClothOptions())
    params = [_params(h, g) for h, g in zip(hands[0], grasp[0], strict=True)]
    batch.reset([np.random.default_rng(seed + k) for k in range(len(params))], params)
    return batch, hands, grasp


def amortised(task: str, steps: int) -> Float:
    """(steps,) processor seconds of a control step, a cloth; eight cloths a call.

    Args:
        task: of all cloths, or "all" for two of each.
        steps: how many.
    """
    batch, hands, grasp = _batch(TASKS * 2 if task == "all" else [task] * 8, steps, 10)
    times = np.zeros(steps)
    for i in range(steps):
        begin = time.thread_time()
        batch.step_many(grasp[i + 1], hands[i + 1], STEP)
        times[i] = (time.thread_time() - begin) / hands.shape[1]
    return times


def _threads(steps: int) -> float:
    """Wall time of two batches one after the other, over theirs in two threads."""

    def run(batch: tuple[ClothBatch, Float, Float]) -> None:
        cloths, hands, grasp = batch
        for i in range(steps):
            cloths.step_many(grasp[i + 1], hands[i + 1], STEP)

    steps = min(steps, 60)
    first, second = (_batch(TASKS, steps, seed) for seed in (20, 30))
    begin = time.perf_counter()
    run(first)
    run(second)
    alone = time.perf_counter() - begin
    pair = [_batch(TASKS, steps, seed) for seed in (20, 30)]
    begin = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(run, pair))
    return alone / (time.perf_counter() - begin)


def _rest_speed() -> float:
    """Fastest vertex after ten seconds with still corners, worst of the tasks, mm/s."""
    fastest = 0.0
    for task in TASKS[:3]:
        hands, grasp = motion(task, 1, seed=2)
        simulator = ClothSimulator(ClothOptions())
        simulator.reset(np.random.default_rng(1), _params(hands[0], grasp[0]))
        for _ in range(300):
            state = simulator.step(grasp[0], hands[0], STEP)
        fastest = max(fastest, float(np.linalg.norm(state.velocities, axis=1).max() * 1e3))
    return fastest
