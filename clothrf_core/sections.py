"""The sections of an experiment file: what may stand in it, its units and its defaults."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from clothrf_core.limits import LimitsSection
from clothrf_core.params import Fabric
from clothrf_core.rig import Section


class RunSection(Section):
    """`[run]`: what makes the run repeatable."""

    seed: int = Field(0, ge=0, description="every random number of the run comes from it")
    rate_hz: float = Field(30.0, gt=0.0, le=250.0, description="control rate")


class FabricSection(Section):
    """`[cloth.fabric]`: areal material parameters; see `Fabric` for the units."""

    name: str = Fabric().name
    density: float = Field(Fabric().density, gt=0.0, description="kg/m^2")
    stretch_warp: float = Field(Fabric().stretch_warp, gt=0.0, description="N/m along v")
    stretch_weft: float = Field(Fabric().stretch_weft, gt=0.0, description="N/m along u")
    shear: float = Field(Fabric().shear, ge=0.0, description="N/m")
    bending: float = Field(Fabric().bending, ge=0.0, description="N m")
    damping: float = Field(Fabric().damping, ge=0.0, description="s")
    drag: float = Field(Fabric().drag, ge=0.0, description="1/s")

    def fabric(self) -> Fabric:
        """The noun."""
        return Fabric(**self.model_dump())


class ClothSection(Section):
    """`[cloth]`: the nominal cloth; a randomiser varies it."""

    size: tuple[float, float] = Field((0.30, 0.35), description="u (hand to hand), v, metres")
    resolution: tuple[int, int] = Field((21, 24), description="vertices along u and v")
    self_collision: bool = Field(False, description="keep layers apart")
    settle_s: float = Field(0.5, ge=0.0, description="simulated seconds before a roll-out starts")
    fabric: FabricSection = FabricSection()
    colour: tuple[float, float, float] = Field((0.10, 0.45, 0.50), description="linear RGB")


class TrainingSection(Section):
    """`[training]`: DAgger (Ross, Gordon, Bagnell 2011)."""

    iterations: int = Field(20, ge=1, description="N")
    rollouts: int = Field(10, ge=1, description="an iteration")
    steps: int = Field(50, ge=1, description="samples a roll-out")
    stride: int = Field(6, ge=1, description="control steps from one sample to the next")
    from_rest: float = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="share of roll-outs that start with the grippers near their rest corners",
    )
    beta: float = Field(0.8, ge=0.0, le=1.0, description="beta_i = beta ** (i - 1)")
    mix: Literal["coin", "blend"] = Field(
        "coin",
        description="coin: the expert acts with probability beta at each step; "
        "blend: beta x* + (1 - beta) x^",
    )
    rebuild: bool = Field(
        True,
        description="build the policy anew at each iteration; false: keep what the first one built "
        "(a forest's trees) and learn only its answers anew",
    )


class CollectionSection(Section):
    """`[collection]`: who computes the roll-outs; the files are the same whoever does."""

    engine: Literal["sequential", "processes", "dask"] = "processes"
    workers: int = Field(2, ge=1, description="processes; one simulator each")
    address: str = Field("local", description="dask: 'local' or tcp://host:port")
    attempts: int = Field(3, ge=1, description="tries a roll-out before it is given up")
    on_failure: Literal["stop", "continue"] = "stop"


class EvaluationSection(Section):
    """`[evaluation]`: held-out roll-outs and closed loop."""

    rollouts: int = Field(20, ge=2, description="held-out roll-outs; never trained on")
    steps: int = Field(50, ge=1, description="samples of each")
    disturbance: float = Field(
        0.02, ge=0.0, description="m, OU noise on the grasp of every second held-out roll-out"
    )
    seeds: int = Field(10, ge=2, description="closed-loop episodes")
    targets: int = Field(10, ge=1, description="hand targets of an episode")
    max_steps: int = Field(1500, ge=1, description="of an episode, if targets are never reached")


class TuneSection(Section):
    """`[tune]`: what `clothrf tune` tries; nothing else reads it."""

    policy: dict[str, Any] = Field(
        {},
        description="option of the policy = list of values to try; nested options in nested "
        "tables; empty = what the policy itself declares",
    )
    search: Literal["halving", "random", "grid"] = Field(
        "halving",
        description="grid: all combinations; random: some of them; halving: many on few "
        "roll-outs, the best third of them on three times as many, and so on",
    )
    candidates: int = Field(27, ge=2, description="combinations at most, the present one included")
    folds: int = Field(4, ge=2, description="sets of whole roll-outs that are left out in turn")
    rollouts: int = Field(60, ge=4, description="expert-led roll-outs to learn from and judge on")


class Experiment(Section):
    """First pass: the sections. Those that name a plugin are checked in the second pass."""

    run: RunSection = RunSection()
    rig: dict[str, Any] = Field({"file": "rigs/yumi_sr300.toml"})
    cloth: ClothSection = ClothSection()
    simulator: dict[str, Any] = {"plugin": "sapien"}
    camera: dict[str, Any] = {"plugin": "raster"}
    features: dict[str, Any] = {"plugin": "how"}
    policy: dict[str, Any] = {"plugin": "forest"}
    tasks: dict[str, dict[str, Any]] = {"straight": {"plugin": "straight"}}
    hands: dict[str, Any] = {"plugin": "targets"}
    randomizer: dict[str, Any] = {"plugin": "none"}
    robot: dict[str, Any] = {"plugin": "simulated"}
    limits: LimitsSection = LimitsSection()
    training: TrainingSection = TrainingSection()
    collection: CollectionSection = CollectionSection()
    evaluation: EvaluationSection = EvaluationSection()
    tune: TuneSection | None = None
