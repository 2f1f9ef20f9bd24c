"""The feature extractor: foreground, anchor, and one group of numbers after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from typing_extensions import override

from clothrf_core.interfaces import FeatureExtractor
from clothrf_core.rig import ForegroundSection, Rig
from clothrf_core.types import CameraModel, Features, Float, Float32, Observation, RgbdFrame
from clothrf_how import foreground_kernels
from clothrf_how.config import FeatureOptions
from clothrf_how.foreground import Foreground, View, anchor, foreground
from clothrf_how.how import How
from clothrf_how.pose import pose, pose_names

# Without a rig everything that is measured may be cloth.
ANYWHERE = ForegroundSection(depth_min=0.0, depth_max=10.0, low=[-1e3] * 3, high=[1e3] * 3)


class GroupFunction(Protocol):
    """What computes one group: a pure function of the foreground, the frame and the anchor."""

    def __call__(self, area: Foreground, frame: RgbdFrame, anchor: Float) -> Float32:
        """(n,) float32, one a name."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A group of features with its names."""

    names: tuple[str, ...]
    compute: GroupFunction


def _how(options: FeatureOptions) -> Channel:
    how = How(options.how)
    return Channel(how.names, lambda area, frame, _anchor: how(area, frame))


def _pose(options: FeatureOptions) -> Channel:
    return Channel(pose_names(), lambda area, _frame, _anchor: pose(area))


CHANNELS: dict[str, Callable[[FeatureOptions], Channel]] = {
    "how": _how,
    "pose": _pose,
}


class Extractor(FeatureExtractor):
    """Foreground of the picture -> anchor in the world -> the configured groups, in their order.

    Pure: equal observations give equal bits. The only thing kept between calls is the table of the
    camera's rays, which is made anew whenever another camera takes the picture.

    Args:
        options: the groups and their options.
        rig: says where cloth may be; None = anything measured is cloth.
    """

    def __init__(self, options: FeatureOptions, rig: Rig | None = None) -> None:
        self.options = options
        self._where = rig.foreground if rig is not None else ANYWHERE
        self._channels = tuple(CHANNELS[group](options) for group in options.groups)
        self._names = tuple(name for channel in self._channels for name in channel.names)
        self._view: View | None = None
        foreground_kernels.warm()

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return self._names

    @override
    def extract(self, observation: Observation) -> Features:
        frame = observation.frame
        area = self.foreground(frame)
        if not area.usable:
            return self._nothing()
        middle = anchor(area)
        parts = [channel.compute(area, frame, middle) for channel in self._channels]
        values = np.concatenate(parts)
        if not (np.isfinite(values).all() and np.isfinite(middle).all()):
            return self._nothing()
        return Features(values=values, names=self._names, anchor=middle)

    def foreground(self, frame: RgbdFrame) -> Foreground:
        """The cloth of a picture; for overlays and tests."""
        view = self._view_of(frame.camera)
        return foreground(frame, view, self._where, self.options.foreground)

    def _view_of(self, camera: CameraModel) -> View:
        view = self._view
        if view is None or not view.shows(camera):
            view = View.of(camera, 2 if self.options.foreground.halve else 1)
            self._view = view
        return view

    def _nothing(self) -> Features:
        return Features(
            values=np.zeros(len(self._names), np.float32),
            names=self._names,
            anchor=np.zeros(3),
            valid=False,
        )
