"""Where one view's board stands, when the lens is known."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from clothrf_calibration import rigid
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.lens import project_jacobian
from clothrf_calibration.views import View
from clothrf_core.types import Float


def fit_pose(
    parameters: Float, points: Float, view: View, *, mask: NDArray[np.bool_] | None = None
) -> tuple[Float, Float]:
    """(4, 4) T_camera_board of one view with known intrinsics, and its (N, 2) residuals.

    Args:
        parameters: intrinsic vector.
        points: (P, 3) of the board as it is.
        view: the view.
        mask: (N,) corners that decide the pose; all by default.
    """
    weight = np.ones(len(view.ids)) if mask is None or not mask.any() else mask.astype(float)
    T = guess_pose(parameters, points, view.keep(weight > 0))
    damping = 1e-6
    chosen = points[view.ids]
    for _ in range(40):
        turned = chosen @ T[:3, :3].T
        local = turned + T[:3, 3]
        pixels, by_point, _ = project_jacobian(parameters, local)
        residual = (pixels - view.pixels) * weight[:, None]
        J = np.concatenate([-by_point @ rigid.skew(turned), by_point], axis=2)
        J = (J * weight[:, None, None]).reshape(-1, 6)
        H = J.T @ J
        H[np.diag_indices(6)] *= 1.0 + damping
        step = -np.linalg.solve(H, J.T @ residual.ravel())
        new = rigid.stepped(T, step)
        moved = project_jacobian(parameters, chosen @ new[:3, :3].T + new[:3, 3])[0]
        value = float((((moved - view.pixels) * weight[:, None]) ** 2).sum())
        before = float((residual**2).sum())
        if value <= before:
            T, damping = new, damping * 0.1
            if before - value < 1e-12 * before:
                break
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e6:
                break
    return T, view.pixels - project_jacobian(parameters, chosen @ T[:3, :3].T + T[:3, 3])[0]


def guess_pose(parameters: Float, points: Float, view: View) -> Float:
    """(4, 4) T_camera_board from a planar solver (IPPE; Collins and Bartoli 2014)."""
    K = np.array([[parameters[0], 0, parameters[2]], [0, parameters[1], parameters[3]], [0, 0, 1]])
    chosen = points[view.ids]
    flat = np.array(chosen)
    flat[:, 2] = 0.0
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        objectPoints=flat,
        imagePoints=view.pixels,
        cameraMatrix=K,
        distCoeffs=parameters[4:] if parameters.size > 4 else np.zeros(5),
        flags=cv2.SOLVEPNP_IPPE,
    )
    best, T = np.inf, np.eye(4)
    for n in range(count):
        trial = np.eye(4)
        trial[:3, :3] = cv2.Rodrigues(src=turns[n])[0]
        trial[:3, 3] = np.ravel(shifts[n])
        local = chosen @ trial[:3, :3].T + trial[:3, 3]
        if (local[:, 2] <= 0).any():
            continue
        error = float(np.abs(project_jacobian(parameters, local)[0] - view.pixels).sum())
        if error < best:
            best, T = error, trial
    if not np.isfinite(best):
        raise CalibrationError(f"{view.name}: no pose of the board explains its corners")
    return T
