"""What a set of robot and board poses can and cannot tell, before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_calibration import rigid
from clothrf_calibration.boards import Board, half_turn
from clothrf_calibration.errors import DegenerateData
from clothrf_core.types import Float

MIN_TURN, GOOD_TURN = 3.0, 10.0
CONSISTENT = 0.5
GOOD_POSES, MIN_POSES = 10, 3


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Strength and consistency of the motions.

    Attributes:
        turns: (3,) RMS rotation in degrees about the three principal axes of all pose pairs.
        weak_axis: (3,) axis in the frame of A about which there is least rotation.
        disagreement: (V,) median over its pairs of |robot angle - camera angle|, degrees.
    """

    turns: Float
    weak_axis: Float
    disagreement: Float

    @property
    def median(self) -> float:
        """Median disagreement of all poses, degrees."""
        return float(np.median(self.disagreement))

    @property
    def bad(self) -> NDArray[np.bool_]:
        """(V,) poses that do not go with the others."""
        spread = 1.4826 * float(np.median(np.abs(self.disagreement - self.median)))
        limit = max(2.5 * self.median, self.median + 6.0 * spread, 0.3)
        return np.asarray(self.disagreement > limit)


def motion(A: Float, C: Float) -> Motion:
    """Of (V, 4, 4) robot poses A and board poses C (see `handeye_start`)."""
    i, j = np.triu_indices(len(A), 1)
    moved, seen = A[i] @ rigid.inverse(A[j]), C[i] @ rigid.inverse(C[j])
    vectors = np.degrees(rigid.log(moved[:, :3, :3]))
    _, s, Vt = np.linalg.svd(vectors, full_matrices=False)
    s = np.concatenate([s, np.zeros(3 - len(s))])
    gap = np.abs(np.linalg.norm(vectors, axis=1) - rigid.angle_deg(seen[:, :3, :3]))
    table = np.zeros((len(A), len(A)))
    table[i, j] = table[j, i] = gap
    disagreement = np.array([np.median(np.delete(row, n)) for n, row in enumerate(table)])
    return Motion(s / np.sqrt(len(i)), Vt[-1], disagreement)


def refuse_degenerate(found: Motion, count: int, *, setup: str) -> list[str]:
    """Warnings about weak motions.

    Raises:
        DegenerateData: there are too few poses, or they turn about one axis only.
    """
    thing = "board" if setup == "fixed" else "camera"
    if count < MIN_POSES:
        raise DegenerateData(
            f"expected at least {MIN_POSES} poses, found {count}; take 15 to 25, turned about "
            "different axes"
        )
    if found.turns[1] < MIN_TURN:
        raise DegenerateData(
            f"degenerate motion: the gripper turned by {found.turns[0]:.1f} degrees about one axis "
            f"and by {found.turns[1]:.1f} degrees about any other, so the {thing}'s position along "
            "that axis is undetermined; add poses turned by 30 degrees about two other axes"
        )
    say = []
    if found.turns[1] < GOOD_TURN:
        say.append(
            f"the gripper turned by only {found.turns[1]:.1f} degrees about a second axis; 20 or "
            "more make the result several times better"
        )
    if count < GOOD_POSES:
        say.append(f"only {count} poses; 15 to 25 are good")
    if found.median > CONSISTENT:
        say.append(
            f"robot and camera disagree about how far things turned (median {found.median:.2f} "
            "degrees): wrong order of poses, pictures taken while moving, or bad intrinsics"
        )
    return say


def unflipped(A: Float, C: Float, board: Board) -> tuple[Float, NDArray[np.bool_]]:
    """Board poses with 180-degree mistakes of a symmetric board undone, and which were turned.

    The angle between two robot poses does not depend on X, so it tells which of the two readings
    of a symmetric board goes with the others.
    """
    none = np.zeros(len(A), bool)
    if not board.turnable or len(A) < 3:
        return C, none
    turned = C @ half_turn(board)
    best, choice = float(motion(A, C).disagreement.mean()), none
    for r in range(len(A)):
        robot = rigid.angle_deg((A @ rigid.inverse(A[r]))[:, :3, :3])
        gaps = [
            np.abs(rigid.angle_deg((D @ rigid.inverse(C[r]))[:, :3, :3]) - robot)
            for D in (C, turned)
        ]
        flips = gaps[1] < gaps[0]
        score = float(motion(A, np.where(flips[:, None, None], turned, C)).disagreement.mean())
        if score < 0.9 * best:
            best, choice = score, flips
    if choice.mean() > 0.5:
        choice = ~choice
    return np.where(choice[:, None, None], turned, C), choice
