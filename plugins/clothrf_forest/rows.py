"""Rows as the forest reads them: features, and if wanted the anchor and what the base says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothrf_core.types import Float, Float32


@dataclass(frozen=True, slots=True)
class Rows:
    """(N, C) numbers that are put together a part at a time; features may be memory-mapped.

    Attributes:
        features: (N, F) float32.
        anchors: (N, 3) float64 appended as three more features, or None.
        projections: (N, h) float32 appended behind them, or None.
    """

    features: Float32
    anchors: Float | None = None
    projections: Float32 | None = None

    def __len__(self) -> int:
        return len(self.features)

    @property
    def width(self) -> int:
        """C."""
        wide = int(self.features.shape[1])
        wide += 0 if self.anchors is None else 3
        return wide + (0 if self.projections is None else int(self.projections.shape[1]))

    def __getitem__(self, index: Any) -> Float32:
        parts = [np.asarray(self.features[index])]
        if self.anchors is not None:
            parts.append(self.anchors[index].astype(np.float32))
        if self.projections is not None:
            parts.append(self.projections[index])
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
