"""The small convolutional net in numpy: what it does to one picture, without torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from clothrf_core.types import Float32

# (name, channels out, kernel, stride); rectified; padding = kernel // 2.
LAYERS = (("c1", 16, 5, 2), ("c2", 32, 3, 2), ("c3", 64, 3, 2), ("c4", 64, 3, 2))
HIDDEN = 128


def channels(pictures: Float32) -> Float32:
    """(N, 2, 64, 64) float32 of (N, 64, 64) depths: depth about its mean, in decimetres, and mask.

    The mean depth itself is one of the numbers that enter after the convolutions.
    """
    mask = pictures > 0.0
    relief = np.where(mask, pictures - mean_depth(pictures)[:, None, None], 0.0) * 10.0
    return np.stack([relief, mask], axis=1).astype(np.float32)


def mean_depth(pictures: Float32) -> Float32:
    """(N,) float32 mean depth of the cells that hold cloth."""
    mask = pictures > 0.0
    count = np.maximum(mask.sum(axis=(1, 2)), 1)
    result: Float32 = (pictures.sum(axis=(1, 2)) / count).astype(np.float32)
    return result


def convolve(picture: Float32, weights: Float32, bias: Float32, stride: int) -> Float32:
    """(O, h, w) correlation of a (C, H, W) picture with (O, C, k, k) weights, zero padding."""
    size = weights.shape[-1]
    pad = size // 2
    padded = np.pad(picture, ((0, 0), (pad, pad), (pad, pad)))
    windows = sliding_window_view(padded, (size, size), axis=(1, 2))[:, ::stride, ::stride]
    out = np.tensordot(weights, windows, axes=([1, 2, 3], [0, 3, 4]))
    result: Float32 = out + bias[:, None, None]
    return result


def forward(arrays: Mapping[str, NDArray[Any]], picture: Float32, extra: Float32) -> Float32:
    """(D,) scaled targets of one (64, 64) depth picture and (e,) further numbers."""
    x = channels(picture[None])[0]
    for name, _, _, stride in LAYERS:
        x = np.maximum(convolve(x, arrays[f"{name}_w"], arrays[f"{name}_b"], stride), 0.0)
    flat = np.concatenate([x.ravel(), extra])
    hidden = np.maximum(arrays["f1_w"] @ flat + arrays["f1_b"], 0.0)
    result: Float32 = arrays["f2_w"] @ hidden + arrays["f2_b"]
    return result
