"""What the cloth is made of, how large it is and how finely it is meshed."""

from __future__ import annotations

import dataclasses

import numpy as np

from clothrf_core.params import Fabric, SimulationParams
from clothrf_randomize.config import FabricSpread, MeshSpread, SizeSpread

_SCALED = ("density", "stretch_warp", "stretch_weft", "shear", "bending", "damping", "drag")

# Ten garment fabrics by name and areal density as published with Wang, O'Brien, Ramamoorthi 2011
# (rounded). Stiffnesses are orders of magnitude only, and stretch is kept where a cloth of this
# size stays nearly inextensible: the task assumes side edges that keep their length.
CATALOGUE = (
    Fabric("gray-interlock", 0.187, 300.0, 250.0, 40.0, 1.0e-5),
    Fabric("ivory-rib-knit", 0.276, 300.0, 250.0, 40.0, 2.0e-5),
    Fabric("camel-ponte-roma", 0.284, 400.0, 400.0, 60.0, 2.0e-5),
    Fabric("white-dots-on-blk", 0.205, 350.0, 350.0, 50.0, 1.0e-5),
    Fabric("navy-sparkle-sweat", 0.204, 350.0, 350.0, 50.0, 1.5e-5),
    Fabric("royal-target", 0.220, 400.0, 400.0, 60.0, 1.0e-5),
    Fabric("tango-red-jet-set", 0.113, 300.0, 250.0, 30.0, 0.5e-5),
    Fabric("pink-ribbon-brown", 0.228, 600.0, 400.0, 80.0, 3.0e-5),
    Fabric("white-swim-solid", 0.228, 300.0, 300.0, 50.0, 1.0e-5),
    Fabric("11oz-black-denim", 0.324, 1500.0, 1000.0, 300.0, 1.0e-4),
)


def vary_fabric(rng: np.random.Generator, nominal: Fabric, spread: FabricSpread) -> Fabric:
    """Another fabric: each parameter times exp(U(-1, 1) strength ln(factor)).

    In mode "catalogue" the centre moves first from the nominal fabric towards a random one of ten,
    the whole way at strength 1 (geometrically).
    """
    factors = np.exp(spread.strength * np.log(spread.factor) * rng.uniform(-1, 1, len(_SCALED)))
    picked = CATALOGUE[int(rng.integers(len(CATALOGUE)))]
    if spread.strength == 0.0:
        return nominal
    name, share = nominal.name, 0.0
    if spread.mode == "catalogue":
        name, share = picked.name, min(spread.strength, 1.0)
    changed = {}
    for key, factor in zip(_SCALED, factors, strict=True):
        here, there = float(getattr(nominal, key)), float(getattr(picked, key))
        centre = here if here <= 0.0 or there <= 0.0 else here ** (1.0 - share) * there**share
        changed[key] = float(centre * factor)
    return Fabric(name=name, **changed)


def vary_cloth(
    rng: np.random.Generator, nominal: SimulationParams, size: SizeSpread, mesh: MeshSpread
) -> SimulationParams:
    """Another size (each side on its own) and another number of vertices (at least 4)."""
    stretch = 1.0 + size.strength * size.spread * rng.uniform(-1.0, 1.0, 2)
    shift = np.rint(mesh.strength * mesh.vertices * rng.uniform(-1.0, 1.0, 2)).astype(int)
    u, v = nominal.size
    columns, rows = nominal.resolution
    return dataclasses.replace(
        nominal,
        size=(float(u * stretch[0]), float(v * stretch[1])),
        resolution=(max(4, columns + int(shift[0])), max(4, rows + int(shift[1]))),
    )
