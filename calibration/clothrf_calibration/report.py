"""One HTML page that holds everything about a camera file, pictures included."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothrf_calibration import plots
from clothrf_calibration.boardpose import fit_pose
from clothrf_calibration.boards import Board
from clothrf_calibration.boardshape import SHAPES, Shape, deformed, shape_basis
from clothrf_calibration.lens import vector
from clothrf_calibration.uncertainty import UncertaintyMap, stated_uncertainty
from clothrf_calibration.views import View
from clothrf_core.rig import CameraSection
from clothrf_core.types import Float

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;
color:#222;background:#fff}
h1{font-size:1.6rem} h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #ddd}
table{border-collapse:collapse;margin:.5rem 0} td,th{padding:.15rem .8rem .15rem 0;text-align:left;
vertical-align:top;font-variant-numeric:tabular-nums} th{font-weight:600;color:#555}
img{max-width:100%;display:block;margin:.6rem 0}
.warn{background:#fff4d6;border-left:4px solid #e0a100;padding:.4rem .8rem;margin:.4rem 0}
.good{background:#e7f6e7;border-left:4px solid #3a9c3a;padding:.4rem .8rem;margin:.4rem 0}
pre{background:#f5f5f5;padding:.6rem;overflow-x:auto;font-size:13px} .note{color:#555}
"""


def report(
    section: CameraSection,
    tables: Mapping[str, Any],
    board: Board,
    shape: str,
    numbers: Float,
    views: Sequence[View],
    *,
    title: str,
    grippers: Float | None = None,
) -> str:
    """The page; `views` are the pictures the file was made from (or others, to be judged).

    Args:
        section: the camera.
        tables: all tables of its file.
        board: the board as drawn.
        shape: its deviation (flat, warp, free) ...
        numbers: ... and the numbers of that.
        views: to draw coverage and residuals of.
        title: heading.
        grippers: (V, 4, 4) T_base_gripper of the views, if there was a robot.
    """
    parameters = vector(np.array(section.K, float), np.array(section.distortion, float))
    known: Shape = next((s for s in SHAPES if s == shape), "flat")
    points = deformed(board, shape_basis(board, known), numbers)
    fitted = [fit_pose(parameters, points, v) for v in views]
    residuals = [r for _, r in fitted]
    rms = np.array([float(np.sqrt((r**2).sum(axis=1).mean())) for r in residuals])
    camera = section.model()
    in_world = [camera.T_world_camera @ pose for pose, _ in fitted]
    found = _uncertainty(tables, parameters, points, views)
    parts = [_head(title, tables), _warnings(tables), _numbers(section, tables)]
    parts.append("<h2>Coverage</h2>" + _image(plots.coverage_plot(views)))
    parts.append(
        "<h2>Residuals</h2>"
        + _image(plots.views_plot([v.name for v in views], rms))
        + _image(plots.residual_plot(views, residuals))
        + "<p class=note>A low residual alone proves nothing: it says how well the model repeats "
        "the pictures it was fitted to, not what it does where there were none. Look at the "
        "held-out error above and at the map below.</p>"
    )
    if found is not None:
        parts.append("<h2>Projection uncertainty</h2>" + _image(plots.uncertainty_plot(found)))
    parts.append("<h2>The rig</h2>" + _image(plots.rig_plot(
        camera, in_world, list(grippers) if grippers is not None else [], points)))  # fmt: skip
    parts.append(_extrinsics(tables))
    parts.append(_provenance(tables))
    body = "\n".join(parts)
    return (
        f"<!doctype html><html lang=en><head><meta charset=utf-8><title>{html.escape(title)}"
        f"</title><style>{STYLE}</style></head><body>\n{body}\n</body></html>\n"
    )


def _uncertainty(
    tables: Mapping[str, Any], parameters: Float, points: Float, views: Sequence[View]
) -> UncertaintyMap | None:
    covariance = np.array(tables.get("uncertainty", {}).get("covariance", []), float)
    if covariance.shape != (parameters.size, parameters.size):
        return None
    return stated_uncertainty(parameters, covariance, points, views)


def _head(title: str, tables: Mapping[str, Any]) -> str:
    r, u = tables.get("residuals", {}), tables.get("uncertainty", {})
    line = []
    if "rms_px" in r:
        line.append(f"residual {r['rms_px']:.3f} px")
    if "held_out_px" in r:
        line.append(f"held out {r['held_out_px']:.3f} &plusmn; {r['held_out_spread_px']:.3f} px")
    if "projection_mean_px" in u:
        line.append(f"projections uncertain by {u['projection_mean_px']:.2f} px on average")
    e = tables.get("extrinsics", {})
    if "sd_mm" in e:
        line.append(f"camera pose &plusmn; {e['sd_mm']:.2f} mm, {e['sd_deg']:.3f} degrees")
    return f"<h1>{html.escape(title)}</h1><p>{'; '.join(line)}</p>"


def _warnings(tables: Mapping[str, Any]) -> str:
    lines = [w for group in tables.get("warnings", {}).values() for w in group]
    if not lines:
        return "<p class=good>No warnings.</p>"
    return "\n".join(f"<p class=warn>{html.escape(w)}</p>" for w in lines)


def _numbers(section: CameraSection, tables: Mapping[str, Any]) -> str:
    u = tables.get("uncertainty", {})
    names, sd = u.get("names", []), u.get("sd", [])
    values = [section.K[0][0], section.K[1][1], section.K[0][2], section.K[1][2]]
    values += list(section.distortion)
    rows = [
        f"<tr><td>{name}<td>{value:.6g}<td>&plusmn; {s:.2g}"
        for name, value, s in zip(names, values, sd, strict=False)
    ]
    tried = tables.get("tried", {})
    other = [
        f"<tr><td>{html.escape(str(name))}<td>{value:.4f}"
        for group in ("models_px", "board_shapes_px")
        for name, value in tried.get(group, {}).items()
    ]
    text = "<h2>Intrinsics</h2><table><tr><th>name<th>value<th>one standard deviation"
    text += "".join(rows) + "</table>"
    if other:
        text += (
            "<p>Held-out error of what was tried (k5: five distortion coefficients; flat, warp, "
            "free: shape of the board), pixels:</p><table>" + "".join(other) + "</table>"
        )
    return text


def _extrinsics(tables: Mapping[str, Any]) -> str:
    e = tables.get("extrinsics")
    if not e:
        return ""
    rows = [
        (k, v) for k, v in e.items()
        if isinstance(v, (int, float, str)) and k not in ("command", "date")
    ]  # fmt: skip
    text = "<h2>Camera pose</h2><table>" + "".join(
        f"<tr><td>{html.escape(k)}<td>{v:.5g}" if isinstance(v, float)
        else f"<tr><td>{html.escape(k)}<td>{html.escape(str(v))}"
        for k, v in rows
    )  # fmt: skip
    matrices = [k for k in e if k.startswith("T_")]
    for name in matrices:
        M = np.array(e[name], float)
        text_m = np.array2string(M, precision=6, suppress_small=True)
        text += f"</table><pre>{name}\n{html.escape(text_m)}</pre><table>"
    return text + "</table>"


def _provenance(tables: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(str(k))}<td>{html.escape(str(v))}"
        for k, v in tables.get("provenance", {}).items()
    )
    dropped = "".join(
        f"<tr><td>{html.escape(str(k))}<td>{html.escape(str(v))}"
        for k, v in tables.get("dropped", {}).items()
    )
    text = f"<h2>How it was made</h2><table>{rows}</table>"
    return text + (f"<p>Left out:</p><table>{dropped}</table>" if dropped else "")


def _image(data: bytes) -> str:
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
