"""Newton's cloth (its Style3D solver, on Warp's processor device) beside ours.

Optional: ``pip install newton`` brings Warp, both under Apache 2.0. The same mesh, density and
motion. Two substeps of ten iterations leave 4 to 8 % strain, ours 1 %; ten of four, half of it for
twice the time. Its vertex block descent needs 400 ms a step for 8 %. Both are made for GPUs.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from clothrf_core.params import SimulationParams
from clothrf_core.provider import Figure
from clothrf_core.types import ClothMesh, ClothState
from clothrf_sapien.bench_motions import STEP, motion
from clothrf_sapien.bench_physics import amortised, strains
from clothrf_sapien.config import ClothOptions
from clothrf_sapien.simulator import ClothSimulator

STRETCH = 1500.0  # N/m, as MuJoCo's in `bench_mujoco`
SUBSTEPS, ITERATIONS = 2, 10


def against_newton(*, quick: bool) -> list[Figure]:
    """Newton's processor time for a control step over ours, ours amortised over eight cloths."""
    steps = 30 if quick else 200
    detail: dict[str, float] = {"substeps": SUBSTEPS, "iterations": ITERATIONS}
    ratios = []
    for task in ("bent", "twisted"):
        theirs, strain = run(task, steps, SUBSTEPS, ITERATIONS)
        ours = amortised(task, steps)
        ratios.append(theirs / float(np.median(ours)))
        detail |= {
            f"{task}_ms": float(np.median(ours) * 1e3),
            f"{task}_newton_ms": theirs * 1e3,
            f"{task}_newton_strain_p999": strain,
        }
    return [Figure("cloth_vs_newton", min(ratios), "ratio", detail)]


def run(task: str, steps: int, substeps: int, iterations: int) -> tuple[float, float]:
    """Median processor seconds of a control step, and the 99.9 % strain."""
    newton: Any = importlib.import_module("newton")  # no stubs, and not of any extra
    warp: Any = importlib.import_module("warp")
    warp.config.quiet = True
    hands, grasp = motion(task, steps + 1, seed=1)
    params = SimulationParams(hands=hands[0], grasp=grasp[0])
    simulator = ClothSimulator(ClothOptions())
    state = simulator.reset(np.random.default_rng(1), params)
    mesh = simulator.mesh()
    with warp.ScopedDevice("cpu"):
        model = _model(newton, warp, mesh, state, params)
        contacts = newton.CollisionPipeline(model).contacts()
        solver = newton.solvers.SolverStyle3D(
            model=model, config=newton.solvers.SolverStyle3D.Config(iterations=iterations)
        )
        now, then, control = model.state(), model.state(), model.control()
        now.particle_q.assign(state.vertices.astype(np.float32))
        times, found = [], []
        before = np.concatenate([hands[0], grasp[0]])
        for i in range(steps):
            after = np.concatenate([hands[i + 1], grasp[i + 1]])
            begin = time.process_time()
            for k in range(substeps):
                now.particle_q.numpy()[mesh.corners] = (
                    before + (after - before) * (k + 1) / substeps
                )
                now.clear_forces()
                solver.step(now, then, control, contacts, STEP / substeps)
                now, then = then, now
            times.append(time.process_time() - begin)
            found.append(strains(now.particle_q.numpy().astype(float), mesh))
            before = after
    late = steps // 5
    strain = float(np.quantile(np.abs(found[late:]), 0.999))
    return float(np.median(times[late:])), strain


def _model(
    newton: Any, warp: Any, mesh: ClothMesh, state: ClothState, params: SimulationParams
) -> Any:
    """The flat cloth with its four corners held."""
    fabric = params.fabric
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    newton.solvers.SolverStyle3D.register_custom_attributes(builder)
    newton.solvers.style3d.add_cloth_mesh(
        builder,
        pos=warp.vec3(0.0, 0.0, 0.0),
        rot=warp.quat_identity(),
        vel=warp.vec3(0.0, 0.0, 0.0),
        vertices=[warp.vec3(u, v, 0.0) for u, v in mesh.rest.tolist()],
        indices=mesh.triangles.ravel().tolist(),
        density=fabric.density,
        panel_verts=mesh.rest.tolist(),
        panel_indices=mesh.triangles.ravel().tolist(),
        tri_aniso_ke=warp.vec3(STRETCH, STRETCH, fabric.shear),
        edge_aniso_ke=warp.vec3(*[fabric.bending] * 3),
    )
    for corner in mesh.corners.tolist():
        builder.particle_mass[corner] = 0.0
    model = builder.finalize()
    flags = model.particle_flags.numpy()
    flags[mesh.corners] &= ~int(newton.ParticleFlags.ACTIVE)
    model.particle_flags.assign(flags)
    return model
