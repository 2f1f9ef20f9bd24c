"""One roll-out: who acts, what is seen, what every expert says about it.

A `RolloutJob` is plain values, so that it can travel to any worker; everything random in it comes
from its seed, so that it gives the same file wherever it runs and however often.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator, SeedSequence

from clothrf_core.compose import Workshop, cached_policy, cached_workshop
from clothrf_core.dataset import Rollout, read_rollout, write_rollout
from clothrf_core.errors import DataError
from clothrf_core.files import names_digest
from clothrf_core.interfaces import Policy
from clothrf_core.loop import decide
from clothrf_core.simulated import Disturbance
from clothrf_core.types import Action, Features, Float, Observation

KINDS = ("iteration", "heldout", "episode")


@dataclass(frozen=True, slots=True)
class Mixture:
    """DAgger's acting policy: pi_i = beta pi* + (1 - beta) pi^_i (Ross et al. 2011, alg. 3.1).

    Attributes:
        beta: share of the expert.
        mix: "coin" tosses one at each step; "blend" averages the targets.
    """

    beta: float
    mix: Literal["coin", "blend"] = "coin"

    def act(self, expert: Action, learner: Action | None, rng: Generator) -> tuple[Action, bool]:
        """The action taken and whether it was the expert's alone."""
        toss = float(rng.random())
        if learner is None or self.beta >= 1.0:
            return expert, True
        if self.mix == "blend":
            targets = self.beta * expert.targets + (1.0 - self.beta) * learner.targets
            confidence = self.beta + (1.0 - self.beta) * learner.confidence
            return Action(targets, confidence), False
        return (expert, True) if toss < self.beta else (learner, False)


@dataclass(frozen=True, slots=True)
class RolloutJob:
    """One roll-out to be done.

    Attributes:
        config: resolved experiment file.
        out: file to write.
        seed: the run's seed.
        kind: "iteration" trains; "heldout" never does.
        iteration: DAgger iteration, from 1; 0 for held-out roll-outs.
        index: number of the roll-out within its iteration.
        task: whose expert leads.
        steps: samples to record.
        stride: control steps from one sample to the next.
        beta: share of the expert.
        mix: how expert and learner are mixed.
        disturbance: m, OU noise on the executed targets.
        from_rest: probability that the grippers start near their rest corners.
        policy: folder of the acting policy; empty = the expert acts alone.
    """

    config: str
    out: str
    seed: int
    kind: str
    iteration: int
    index: int
    task: str
    steps: int
    stride: int = 1
    beta: float = 1.0
    mix: Literal["coin", "blend"] = "coin"
    disturbance: float = 0.0
    from_rest: float = 0.0
    policy: str = ""

    @property
    def name(self) -> str:
        """How messages call it; holds the seed that repeats it."""
        return f"{self.kind} {self.iteration} roll-out {self.index} (seed {self.seed})"

    def run(self) -> str:
        """Do it unless its intact file is there already; returns the file's path."""
        path = Path(self.out)
        if path.exists():
            try:
                read_rollout(path)
                return self.out
            except DataError:
                path.unlink()
        policy = cached_policy(self.policy) if self.policy else None
        write_rollout(path, roll_out(cached_workshop(self.config), self, policy))
        return self.out


def stream(seed: int, kind: str, iteration: int, index: int) -> SeedSequence:
    """The one random stream of a roll-out, independent of who computes it and when."""
    return SeedSequence(seed, spawn_key=(KINDS.index(kind), iteration, index))


def roll_out(shop: Workshop, job: RolloutJob, policy: Policy | None) -> Rollout:
    """Act until the last of `steps` samples; look and record at every stride-th control step.

    Between two looks the learner's last answer holds, and the expert, who needs no picture, goes
    on following the hands. So samples lie farther apart in time than control steps, at no cost in
    pictures: 10,000 samples of 200 roll-outs at every sixth step give 8.4 mm where as many of 100
    roll-outs at every third step give 10.0 mm (three tasks, SR300 noise, held out).
    """
    world_seed, coin_seed, disturb_seed = stream(
        job.seed, job.kind, job.iteration, job.index
    ).spawn(3)
    coin, push = np.random.default_rng(coin_seed), np.random.default_rng(disturb_seed)
    disturbance = Disturbance(job.disturbance, shop.limits.dt)
    mixture = Mixture(job.beta, job.mix)
    lead = shop.experts[job.task]
    shop.world.reset(world_seed, lead, from_rest=job.from_rest)
    offset = np.zeros((2, 3))
    rows: list[_Row] = []
    with shop.camera, shop.robot:
        for sequence in range((job.steps - 1) * job.stride + 1):
            state = shop.world.state
            expert = lead.label(state)
            look = sequence % job.stride == 0
            if look:
                frame = shop.camera.read()
            observation = Observation(frame, shop.robot.state())
            if look:
                features = shop.extractor.extract(observation)
                learner = (
                    None
                    if policy is None
                    else decide(policy, features, job.task, observation.grasp)
                )
                action, by_expert = mixture.act(expert, learner, coin)
            elif by_expert:
                action = expert
            if job.disturbance > 0.0:
                offset = disturbance.next(offset, push)
            pushed = Action(action.targets + offset, action.confidence)
            command = shop.limits.command(pushed, observation, sequence)
            if look:
                rows.append(
                    _Row(
                        features,
                        np.stack([e.label(state).targets for e in shop.experts.values()]),
                        np.asarray(command.targets),
                        np.asarray(observation.grasp.positions),
                        np.asarray(state.hands),
                        by_expert,
                        action.confidence,
                        state.feasible,
                    )
                )
            shop.robot.send(command)
    return _stacked(rows, job, shop)


@dataclass(frozen=True, slots=True)
class _Row:
    features: Features
    labels: Float
    executed: Float
    grasp: Float
    hands: Float
    by_expert: bool
    confidence: float
    feasible: bool


def _stacked(rows: list[_Row], job: RolloutJob, shop: Workshop) -> Rollout:
    return Rollout(
        features=np.stack([r.features.values for r in rows]),
        valid=np.array([r.features.valid for r in rows]),
        anchors=np.stack([r.features.anchor for r in rows]),
        labels=np.stack([r.labels for r in rows]),
        executed=np.stack([r.executed for r in rows]),
        grasps=np.stack([r.grasp for r in rows]),
        hands=np.stack([r.hands for r in rows]),
        by_expert=np.array([r.by_expert for r in rows]),
        confidence=np.array([r.confidence for r in rows], float),
        feasible=np.array([r.feasible for r in rows]),
        meta={
            "kind": job.kind,
            "iteration": job.iteration,
            "index": job.index,
            "seed": job.seed,
            "task": job.task,
            "tasks": list(shop.experts),
            "names": names_digest(shop.extractor.names),
            "beta": job.beta,
        },
    )
