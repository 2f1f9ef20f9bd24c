"""Roll-outs that experts lead: what controllers are compared and tuned on."""

from __future__ import annotations

from pathlib import Path

from clothrf_core.dataset import Dataset
from clothrf_core.rollout import RolloutJob


def expert_jobs(
    config: Path,
    data: Dataset,
    *,
    seed: int,
    kind: str,
    count: int,
    steps: int,
    stride: int,
    disturbance: float,
    from_rest: float,
) -> list[RolloutJob]:
    """`count` roll-outs of iteration 1; the experts take turns in leading them.

    Every second one is pushed off the expert's path, so that a policy learns the way back.

    Args:
        config: resolved experiment file.
        data: where the roll-outs are kept.
        seed: of all of them.
        kind: "iteration" for rows to learn from, "heldout" for rows to be judged on.
        count: how many.
        steps: samples of each.
        stride: control steps between samples.
        disturbance: m, OU noise on the executed targets of every second one.
        from_rest: probability that the grippers start near their rest corners.
    """
    return [
        RolloutJob(
            config=str(config),
            out=str(data.path(1, index, kind=kind)),
            seed=seed,
            kind=kind,
            iteration=1,
            index=index,
            task=data.tasks[(index // 2) % len(data.tasks)],
            steps=steps,
            stride=stride,
            disturbance=disturbance if index % 2 else 0.0,
            from_rest=from_rest,
        )
        for index in range(count)
    ]
