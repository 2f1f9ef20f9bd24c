"""Ten fabrics, by order of magnitude, as `Fabric` parameters.

Names and areal densities are those of Wang, O'Brien and Ramamoorthi, "Data-driven elastic models
for cloth: modeling and measurement", ACM Transactions on Graphics 30(4), 2011. Their stiffnesses
are curves over strain and direction; here stand single numbers of the same order, rounded: knits
(interlock, jersey, ponte) stretch easily, wovens hardly, denim and canvas-like cloth bends least.
All are stiffened beyond a small strain by the simulator (`ClothOptions.strain_limit`), as real
cloth is.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from clothrf_core.params import Fabric

FABRICS: Mapping[str, Fabric] = MappingProxyType(
    {
        fabric.name: fabric
        for fabric in (
            # name, density, warp, weft, shear, bending, damping, drag
            Fabric("camel-ponte-roma", 0.284, 400.0, 400.0, 60.0, 2.0e-5, 2.0e-3, 1.0),
            Fabric("gray-interlock", 0.187, 250.0, 200.0, 40.0, 1.2e-5, 2.0e-3, 1.5),
            Fabric("11oz-black-denim", 0.373, 2000.0, 1600.0, 200.0, 2.0e-4, 2.0e-3, 0.8),
            Fabric("white-dots-on-black", 0.204, 600.0, 500.0, 60.0, 2.0e-5, 2.0e-3, 1.4),
            Fabric("navy-sparkle-sweat", 0.204, 300.0, 250.0, 50.0, 3.0e-5, 2.0e-3, 1.4),
            Fabric("pink-ribbon-brown", 0.228, 800.0, 500.0, 80.0, 5.0e-5, 2.0e-3, 1.2),
            Fabric("ivory-rib-knit", 0.276, 200.0, 150.0, 30.0, 1.0e-5, 2.0e-3, 1.0),
            Fabric("white-swim-solid", 0.223, 300.0, 300.0, 50.0, 1.5e-5, 2.0e-3, 1.3),
            Fabric("tango-red-jet-set", 0.113, 250.0, 250.0, 30.0, 5.0e-6, 2.0e-3, 2.5),
            Fabric("royal-target", 0.220, 500.0, 400.0, 60.0, 2.0e-5, 2.0e-3, 1.3),
        )
    }
)
"""Name -> fabric; the first is the default."""
