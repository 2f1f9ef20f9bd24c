"""How good is a policy: held-out error, closed loop, and how sure we are of either.

Errors are per coordinate: RMS = sqrt(mean (x* - x^)^2) over samples, grasp points and axes, as in
the paper's err; NRE divides the mean square by the variance of x* about its mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core.compose import Workshop, cached_policy, cached_workshop
from clothrf_core.interfaces import Policy
from clothrf_core.loop import decide
from clothrf_core.rollout import stream
from clothrf_core.types import DatasetView, Float, Observation

# Student's t, 97.5 %, for 1..30 degrees of freedom.
T_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
    2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
    2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip


def predictions(policy: Policy, view: DatasetView) -> tuple[Float, Float]:
    """(N, T, G, 3) predicted targets and (N, T) confidences of all rows and tasks."""
    shape = (len(view), len(view.tasks), *view.labels.shape[2:])
    targets, confidence = np.empty(shape), np.empty(shape[:2])
    for row in range(len(view)):
        features = view.feature_row(row)
        for t, task in enumerate(view.tasks):
            action = policy.act(features, task)
            targets[row, t] = action.targets
            confidence[row, t] = action.confidence
    return targets, confidence


def held_out(policy: Policy, view: DatasetView) -> dict[str, Any]:
    """Error on rows the policy never saw: overall and per task.

    Returns ``rms_mm``, ``mse_m2``, ``nre``, ``confidence`` (median) and ``tasks`` with the same
    numbers for each task.
    """
    return judged(view, *predictions(policy, view))


def judged(view: DatasetView, targets: Float, confidence: Float) -> dict[str, Any]:
    """`held_out` of (N, T, G, 3) targets and (N, T) confidences that are known already."""
    overall = error_numbers(view.labels, targets)
    per_task = {
        task: error_numbers(view.labels[:, t], targets[:, t]) for t, task in enumerate(view.tasks)
    }
    return {**overall, "confidence": float(np.median(confidence)), "tasks": per_task}


def error_numbers(labels: Float, targets: Float) -> dict[str, float]:
    """MSE in m^2, RMS in mm and NRE of (N, ..., 3) targets against labels."""
    square = (np.asarray(labels) - targets) ** 2
    variance = float(np.var(labels, axis=0).mean())
    mse = float(square.mean())
    return {
        "rms_mm": 1e3 * float(np.sqrt(mse)),
        "mse_m2": mse,
        "nre": mse / variance if variance > 0 else float("nan"),
    }


def interval(values: Float) -> tuple[float, float]:
    """Mean and half-width of the 95 % confidence interval of the mean (Student's t)."""
    n = len(values)
    if n < 2:
        return float(np.mean(values)), float("nan")
    t = T_975[n - 2] if n - 1 <= len(T_975) else 1.96
    return float(np.mean(values)), float(t * np.std(values, ddof=1) / np.sqrt(n))


@dataclass(frozen=True, slots=True)
class EpisodeJob:
    """One closed-loop episode: the hands visit random targets, one controller acts alone.

    Attributes:
        config: resolved experiment file.
        policy: policy folder; empty = the expert.
        task: the task.
        seed: the run's seed.
        index: number of the episode; the same number gives the same hands to every controller.
        targets: hand targets to visit.
        max_steps: end in any case.
        then: tasks that follow `task`, each for `every_s`, over and over; empty = none.
        every_s: how long each of them lasts, s.
    """

    config: str
    policy: str
    task: str
    seed: int
    index: int
    targets: int
    max_steps: int
    then: tuple[str, ...] = ()
    every_s: float = 4.0

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"episode {self.index} of {self.task} (seed {self.seed})"

    def task_at(self, time_s: float) -> str:
        """The task that is asked for `time_s` after the start."""
        turns = (self.task, *self.then)
        return turns[int(time_s / self.every_s + 1e-9) % len(turns)]

    def run(self) -> dict[str, float]:
        """Errors in mm of the grasp against x* of the same instant."""
        policy = cached_policy(self.policy) if self.policy else None
        errors, invalid = episode(cached_workshop(self.config), self, policy)
        return {
            "mean_mm": 1e3 * float(errors.mean()),
            "p95_mm": 1e3 * float(np.percentile(errors, 95)),
            "steps": float(len(errors)),
            "invalid": float(invalid),
        }


def episode(shop: Workshop, job: EpisodeJob, policy: Policy | None) -> tuple[Float, int]:
    """(S,) mean distance of the grippers from x* in metres, and how many frames were invalid."""
    shop.world.reset(stream(job.seed, "episode", 0, job.index), shop.experts[job.task])
    errors: list[float] = []
    invalid = 0
    with shop.camera, shop.robot:
        for sequence in range(job.max_steps):
            if shop.world.arrivals >= job.targets:
                break
            task = job.task_at(sequence * shop.limits.dt)
            expert = shop.experts[task]
            truth = expert.label(shop.world.state)
            observation = Observation(shop.camera.read(), shop.robot.state())
            action = truth
            if policy is not None:
                features = shop.extractor.extract(observation)
                invalid += not features.valid
                action = decide(policy, features, task, observation.grasp)
            shop.robot.send(shop.limits.command(action, observation, sequence))
            wanted = expert.label(shop.world.state).targets
            errors.append(float(np.linalg.norm(shop.world.state.grasp - wanted, axis=1).mean()))
    return np.array(errors), invalid


def confidence_curve(
    labels: Float, targets: Float, confidence: Float, *, bins: int = 10
) -> NDArray[np.float64]:
    """(B, 3): mean confidence, RMS error in mm, number of samples, in bins of confidence."""
    error = np.sqrt(((labels - targets) ** 2).mean(axis=tuple(range(2, labels.ndim))))
    edges = np.linspace(0.0, 1.0, bins + 1)
    which = np.clip(np.digitize(confidence, edges) - 1, 0, bins - 1)
    rows = []
    for b in range(bins):
        inside = which == b
        if inside.any():
            rms = 1e3 * float(np.sqrt((error[inside] ** 2).mean()))
            rows.append((float(confidence[inside].mean()), rms, float(inside.sum())))
    return np.array(rows).reshape(-1, 3)
