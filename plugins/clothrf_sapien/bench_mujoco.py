"""MuJoCo's flex beside our cloth: the same mesh, weights, motion and processor."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np

from clothrf_core.errors import MissingDependency
from clothrf_core.params import Fabric, SimulationParams
from clothrf_core.provider import Figure
from clothrf_core.types import ClothMesh, Float
from clothrf_sapien.bench_motions import STEP, motion
from clothrf_sapien.bench_physics import amortised, strains
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.simulator import ClothSimulator
from clothrf_sapien.weave import weave

STRETCH = 1500.0
"""N/m; gives MuJoCo, which has no strain limit, about the strain of our cloth, or a little more."""


def against_mujoco(*, quick: bool) -> list[Figure]:
    """MuJoCo's time for a control step over ours, one thread; ours amortised over eight cloths.

    ``..._one_cloth_ratio`` compares single cloths stepped in turns, Python's part included.
    """
    if int(mujoco.__version__.split(".")[0]) < 4:
        raise MissingDependency(
            "benchmark 'cloth against MuJoCo' needs mujoco >= 4.0, which integrates flex "
            f"implicitly; found {mujoco.__version__}. Install it with: pip install 'mujoco>=4.0'"
        )
    steps = 60 if quick else 300
    detail: dict[str, float] = {}
    ratios = []
    for task in ("bent", "twisted"):
        ours, theirs, strain, other, apart = _race(task, steps)
        many = amortised(task, steps)
        ratios.append(float(np.median(theirs) / np.median(many)))
        detail |= {
            f"{task}_ratio": ratios[-1],
            f"{task}_one_cloth_ratio": float(np.median(theirs) / np.median(ours)),
            f"{task}_ms": float(np.median(many) * 1e3),
            f"{task}_one_cloth_ms": float(np.median(ours) * 1e3),
            f"{task}_mujoco_ms": float(np.median(theirs) * 1e3),
            f"{task}_strain_p999": strain,
            f"{task}_mujoco_strain_p999": other,
            f"{task}_apart_rms_mm": apart * 1e3,
        }
    return [Figure("cloth_vs_mujoco", min(ratios), "ratio", detail)]


def _race(task: str, steps: int) -> tuple[Float, Float, float, float, float]:
    """Processor seconds of both, 99.9 % strains of both, RMS distance of their vertices, m."""
    hands, grasp = motion(task, steps + 1, seed=1)
    params = SimulationParams(hands=hands[0], grasp=grasp[0])
    simulator = ClothSimulator(ClothOptions())
    state = simulator.reset(np.random.default_rng(1), params)
    mesh = simulator.mesh()
    model = _model(mesh, params)
    data = mujoco.MjData(model)
    flat = np.concatenate([mesh.rest, np.zeros((len(mesh.rest), 1))], axis=1)
    held = (3 * mesh.corners[:, None] + np.arange(3)).ravel()
    data.qpos[:] = (state.vertices - flat).ravel()
    times = np.zeros((2, steps))
    found: list[list[Float]] = [[], []]
    apart = []
    before = np.concatenate([hands[0], grasp[0]])
    for i in range(steps):
        corners = np.concatenate([hands[i + 1], grasp[i + 1]])
        begin = time.thread_time()
        state = simulator.step(grasp[i + 1], hands[i + 1], STEP)
        times[0, i] = time.thread_time() - begin
        begin = time.thread_time()
        # Heavy corners that are told where to be: flex does not take kinematic bodies.
        data.qpos[held] = (before - flat[mesh.corners]).ravel()
        data.qvel[held] = ((corners - before) / STEP).ravel()
        mujoco.mj_step(model, data)
        times[1, i] = time.thread_time() - begin
        other = flat + data.qpos.reshape(-1, 3)
        for k, vertices in enumerate((state.vertices, other)):
            found[k].append(strains(vertices, mesh))
        apart.append(np.mean(np.sum((state.vertices - other) ** 2, axis=1)))
        before = corners
    late = steps // 5
    worst = [float(np.quantile(np.abs(f[late:]), 0.999)) for f in found]
    return times[0], times[1], worst[0], worst[1], float(np.sqrt(np.mean(apart[late:])))


def _model(mesh: ClothMesh, params: SimulationParams) -> Any:
    """The cloth as one flex of point masses."""
    mass = weave(params, strain_limit=0.0, taut=0.0).mass
    fabric: Fabric = params.fabric
    thickness = float(np.sqrt(12.0 * fabric.bending / STRETCH))
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    bodies = []
    for i, (u, v) in enumerate(mesh.rest):
        held = i in mesh.corners
        bodies.append(
            f'<body name="b{i}" pos="{u} {v} 0" gravcomp="{int(held)}">'
            f'<inertial pos="0 0 0" mass="{1.0 if held else mass[i]}" '
            f'diaginertia="1e-9 1e-9 1e-9"/>{slides}</body>'
        )
    names = " ".join(f"b{i}" for i in range(len(mass)))
    elements = " ".join(map(str, mesh.triangles.ravel()))
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco>
        <option timestep="{STEP}" integrator="discrete" solver="CG"/>
        <size memory="200M"/>
        <worldbody>{"".join(bodies)}</worldbody>
        <deformable><flex name="cloth" dim="2" radius="0.001" body="{names}" element="{elements}">
        <contact selfcollide="none" contype="0" conaffinity="0"/>
        <elasticity young="{STRETCH / thickness}" poisson="0" thickness="{thickness}"
            damping="{fabric.damping}" elastic2d="both"/>
        </flex></deformable></mujoco>"""
    )
