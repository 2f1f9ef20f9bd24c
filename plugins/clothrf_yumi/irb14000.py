"""The numbers of ABB's IRB 14000 (YuMi): axes, limits, masses, and capsules around its links.

Lengths and base angles reproduce the controller's own home pose to 1e-12 m, which the usual public
URDFs miss by 1.5 mm. Masses and inertias are estimates (uniform density over convex hulls, 6.9 kg
an arm): good enough to draw and to brake, not for torque control.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within `radius` of the segment from `start` to `end`; metres."""

    start: Triple
    end: Triple
    radius: float


@dataclass(frozen=True, slots=True)
class Mass:
    """Mass in kg, centre in m, principal moments about the centre in kg m^2."""

    mass: float
    centre: Triple
    moments: Triple


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: its frame by modified Denavit-Hartenberg parameters (Craig 1986), and its link.

    The frame follows from the previous one as Rx(alpha) Tx(a) Rz(offset + q) Tz(d).

    Attributes:
        number: ABB's name; the chain is 1, 2, 7, 3, 4, 5, 6.
        alpha: twist of the previous link, rad.
        a: length of the previous link, m.
        offset: angle at ABB's zero, rad.
        d: distance along this axis, m.
        lower: least angle, degrees.
        upper: greatest angle, degrees.
        speed: greatest speed, degrees a second.
        link: capsule around the link, in this frame.
        mass: estimate, in this frame.
    """

    number: int
    alpha: float
    a: float
    offset: float
    d: float
    lower: float
    upper: float
    speed: float
    link: Capsule
    mass: Mass


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box of the body, robot frame, metres."""

    name: str
    low: Triple
    high: Triple


# fmt: off
AXES = (
    Axis(1, 0.0, 0.0, 0.0, 0.166, -168.5, 168.5, 180.0,
         Capsule((-.000, -.001, -.095), (-.032, .035, -.006), .062),
         Mass(1.32, (-.016, .021, -.038), (3.2e-3, 3.2e-3, 2.4e-3))),
    Axis(2, -pi / 2, -0.030, 0.0, 0.0, -143.5, 43.5, 180.0,
         Capsule((.033, -.135, -.001), (.001, .000, -.030), .062),
         Mass(1.99, (.015, -.067, -.016), (8.7e-3, 3.5e-3, 8.7e-3))),
    Axis(7, pi / 2, 0.030, 0.0, 0.2515, -168.5, 168.5, 180.0,
         Capsule((.001, .001, -.052), (.041, .034, .000), .053),
         Mass(0.90, (.024, .023, -.023), (1.6e-3, 1.7e-3, 1.5e-3))),
    Axis(3, -pi / 2, 0.0405, -pi / 2, 0.0, -123.5, 80.0, 180.0,
         Capsule((.002, .002, -.029), (.045, .131, .002), .056),
         Mass(1.60, (.020, .062, -.016), (6.1e-3, 2.6e-3, 6.2e-3))),
    Axis(4, -pi / 2, 0.0405, pi, 0.265, -290.0, 290.0, 400.0,
         Capsule((-.002, .003, -.086), (.018, .046, -.006), .045),
         Mass(0.55, (.011, .024, -.045), (9.4e-4, 8.8e-4, 5.7e-4))),
    Axis(5, -pi / 2, 0.027, 0.0, 0.0, -88.0, 138.0, 400.0,
         Capsule((-.022, .008, -.010), (-.010, .011, -.016), .059),
         Mass(0.50, (-.013, .010, -.011), (5.1e-4, 5.1e-4, 5.6e-4))),
    Axis(6, pi / 2, -0.027, 0.0, 0.0, -229.0, 229.0, 400.0,
         Capsule((-.006, -.005, .032), (.006, .007, .032), .027),
         Mass(0.05, (.000, .002, .030), (1e-5, 1e-5, 2e-5))),
)
# fmt: on

FLANGE_M = 0.036  # tool0 stands this far along axis 6
FINGER_TCP_M = 0.1142  # between the finger tips, along z of tool0

# Smart gripper with two fingers, in tool0.
GRIPPER = Mass(0.230, (0.0082, 0.0117, 0.0520), (2.1e-4, 2.4e-4, 0.9e-4))
GRIPPER_BODY = Capsule((0.0, 0.0, 0.029), (0.0, 0.0, 0.056), 0.044)
FINGERS = Capsule((-0.019, 0.0, 0.108), (0.019, 0.0, 0.108), 0.028)  # over their full stroke

BASE_MASS = Mass(24.18, (-0.20, 0.0, 0.15), (0.6, 0.8, 0.6))

# Left arm's base is Ry(60 deg) Rx(-20 deg) Rz(-41.2 deg); the right arm's has the opposite signs.
BASE_XYZ: Triple = (0.0, 0.050, 0.384)
BASE_ANGLES_DEG: Triple = (60.0, -20.0, -41.2)

BODY = (
    Box("lower_body", (-0.36, -0.20, -0.10), (0.0, 0.20, 0.10)),
    Box("lap", (0.0, -0.20, -0.02), (0.135, 0.20, 0.06)),
    Box("column", (-0.36, -0.112, 0.10), (-0.12, 0.112, 0.30)),
    Box("head", (-0.36, -0.13, 0.28), (0.088, 0.13, 0.471)),
)

SIDES = ("left", "right")


def joint_name(number: int, side: str) -> str:
    """The joint's name: ``yumi_joint_7_l`` is axis 7 of the left arm."""
    return f"yumi_joint_{number}_{side[0]}"


# Seven of the left arm, then seven of the right, each along its chain.
JOINT_NAMES = tuple(joint_name(axis.number, side) for side in SIDES for axis in AXES)
