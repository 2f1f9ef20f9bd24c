"""Gabor kernels: a wave under a Gaussian, the wrinkle detector of the histogram.

    g(x, y) = exp(-(x'^2 + gamma^2 y'^2) / (2 sigma^2)) cos(2 pi x' / wavelength + psi),
    x' = x cos(theta) + y sin(theta),   y' = -x sin(theta) + y cos(theta)

(Daugman 1985; OpenCV's convention.) The published parameters are sigma 6, wavelength 10,
gamma 0.5, psi 0, 101 x 101 at 640 x 480; at half the resolution sigma 3 and wavelength 5 select
the same wrinkles.

`factors` gives the same filters as products of one-dimensional ones, which is what makes them
fast: at 0 and 90 degrees the kernel is an outer product; at 45 and 135 degrees it is one in the
diagonal coordinates s = x + y, t = x - y, where the pixels with s and t even and those with s and
t odd are two such products.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clothrf_core.types import Float, Float32
from clothrf_how.config import HowOptions


def gabor(
    theta: float, *, sigma: float, wavelength: float, gamma: float, psi: float, size: int
) -> Float:
    """(size, size) float64 kernel, as ``cv2.getGaborKernel`` makes it up to its orientation.

    OpenCV stores the kernel turned by 180 degrees; with psi = 0 both are the same.
    """
    half = size // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    across = x * math.cos(theta) + y * math.sin(theta)
    along = -x * math.sin(theta) + y * math.cos(theta)
    envelope = np.exp(-(across**2 + (gamma * along) ** 2) / (2.0 * sigma**2))
    kernel: Float = envelope * np.cos(2.0 * math.pi * across / wavelength + psi)
    return kernel


def bank(
    options: HowOptions, *, orientations: int, wavelength: float, psi: float
) -> tuple[Float32, ...]:
    """`orientations` kernels (size, size) float32, at i pi / orientations, normed as configured.

    Sigma grows with the wavelength, so that a second wavelength is the same filter enlarged.
    """
    sigma = options.sigma * wavelength / options.wavelength
    kernels = []
    for i in range(orientations):
        kernel = gabor(
            math.pi * i / orientations,
            sigma=sigma,
            wavelength=wavelength,
            gamma=options.gamma,
            psi=psi,
            size=options.kernel_size,
        )
        if options.zero_mean:
            kernel = kernel - kernel.mean()
        if options.unit_norm:
            kernel = kernel / np.linalg.norm(kernel)
        kernels.append(kernel.astype(np.float32))
    return tuple(kernels)


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """One orientation's kernel as two passes along lines of pixels, for one or two parities.

    Attributes:
        along: (P, 2, n) taps of the Gaussian pass: [p, 0] offsets in steps, [p, 1] weights.
        across: (P, 2, m) taps of the wave pass, likewise.
        along_step: (dx, dy) pixels of one step of the Gaussian pass.
        across_step: (dx, dy) pixels of one step of the wave pass.
        shift: (P,) columns by which parity p's picture is shifted.
    """

    along: Float
    across: Float
    along_step: tuple[int, int]
    across_step: tuple[int, int]
    shift: tuple[int, ...]

    def kernel(self) -> Float:
        """The two-dimensional kernel that the passes amount to (odd, square, float64)."""
        reach = self.reach()
        result = np.zeros((2 * reach + 1, 2 * reach + 1))
        for p, shift in enumerate(self.shift):
            for k, a in self.across[p].T:
                for n, b in self.along[p].T:
                    x = shift + int(k) * self.across_step[0] + int(n) * self.along_step[0]
                    y = int(k) * self.across_step[1] + int(n) * self.along_step[1]
                    result[reach + y, reach + x] += a * b
        return result

    def reach(self) -> int:
        """Pixels that the kernel looks away from its middle, at most, in x or y."""
        total = int(np.abs(self.across[:, 0]).max() + np.abs(self.along[:, 0]).max())
        return total + max(self.shift)


def factors(options: HowOptions, *, psi: float) -> tuple[Factors, ...]:
    """Passes of the four orientations 0, 45, 90, 135 degrees.

    The wave ends at 3.5 sigma across and the Gaussian at ``kernel_size // 2`` pixels along (2.5
    sigma by default), where the published square window ends. Zero mean is reached inside the wave
    (Morlet's correction: the wave minus a share of its own Gaussian), which keeps it a product.
    """
    return tuple(_factors(options, i, psi) for i in range(4))


def _factors(options: HowOptions, index: int, psi: float) -> Factors:
    sigma, gamma = options.sigma, options.gamma
    half = float(options.kernel_size // 2)
    across_end = min(half, 3.5 * sigma)
    diagonal = index % 2 == 1
    pitch = math.sqrt(0.5) if diagonal else 1.0
    waves, bells, smooths = [], [], []
    for parity in (0, 1) if diagonal else (0,):
        s = _lattice(across_end / pitch, parity=parity, diagonal=diagonal)
        t = _lattice(half / pitch, parity=parity, diagonal=diagonal)
        u = s * pitch
        bell = np.exp(-(u**2) / (2.0 * sigma**2))
        # At 45 degrees x' = s / sqrt 2; at 135 degrees x' = -t / sqrt 2, hence the sign of psi.
        wave = bell * np.cos(2.0 * math.pi * u / options.wavelength + (-psi if index == 3 else psi))
        waves.append((s, wave))
        bells.append(bell)
        smooths.append((t, np.exp(-((gamma * t * pitch) ** 2) / (2.0 * sigma**2))))
    if options.zero_mean:
        weight = [b[1].sum() for b in smooths]
        mean = sum(w[1].sum() * g for w, g in zip(waves, weight, strict=True))
        share = mean / sum(b.sum() * g for b, g in zip(bells, weight, strict=True))
        waves = [(s, w - share * b) for (s, w), b in zip(waves, bells, strict=True)]
    if options.unit_norm:
        square = sum(
            (w[1] ** 2).sum() * (g[1] ** 2).sum() for w, g in zip(waves, smooths, strict=True)
        )
        waves = [(s, w / math.sqrt(square)) for s, w in waves]
    steps = {0: ((1, 0), (0, 1)), 1: ((1, 1), (1, -1)), 2: ((0, 1), (1, 0)), 3: ((1, -1), (1, 1))}
    across_step, along_step = steps[index]
    return Factors(
        along=_stack(smooths, diagonal=diagonal),
        across=_stack(waves, diagonal=diagonal),
        along_step=along_step,
        across_step=across_step,
        shift=(0, 1) if diagonal else (0,),
    )


def _lattice(end: float, *, parity: int, diagonal: bool) -> Float:
    """Integers in [-end, end]; on a diagonal those of one parity."""
    last = math.floor(end + 1e-9)
    values = np.arange(-last, last + 1, dtype=float)
    return values[np.abs(values) % 2 == parity] if diagonal else values


def _stack(taps: list[tuple[Float, Float]], *, diagonal: bool) -> Float:
    """(P, 2, n): steps and weights of each parity, padded with zero weights to one length."""
    n = max(s.size for s, _ in taps)
    result = np.zeros((len(taps), 2, n))
    for p, (s, weight) in enumerate(taps):
        # s = 2 k + parity on a diagonal, s = k otherwise.
        result[p, 0, : s.size] = np.floor(s / 2.0) if diagonal else s
        result[p, 1, : s.size] = weight
    return result
