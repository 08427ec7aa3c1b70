"""Methods of other libraries at settings that need no truth: scikit-image, and OpenCV and pyproximal if installed.

scikit-image is a dependency; the others come with the extra `peers`.
"""

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from skimage import restoration

from tactiled.arrays import Floats
from tactiled.bench.skin import Frames

Restore = Callable[[Frames], Any]

BALANCES = (0.1, 0.3, 1.0)  # of Wiener filters, times the noise over the peak: 0.3 suits most scenes
FLAT_BALANCES = (0.3, 1.0, 3.0)  # the same where the filter's prior is white
STOPS = (10, 30, 100)  # iterations
MODULES = {"skimage": "skimage", "opencv": "cv2", "pyproximal": "pyproximal"}  # by a method's first word


def absent() -> list[str]:
    """The libraries that are not installed."""
    return [name for name, module in MODULES.items() if find_spec(module) is None]


def peers(psf: Floats, shape: tuple[int, ...], noise: float, stops: tuple[int, ...] = STOPS) -> dict[str, Restore]:
    """Every library's restorations of frames of `shape` with `noise`, over their peak, by the odd point spread."""
    single = psf.astype(np.float32)
    runs: dict[str, Restore] = {
        f"skimage wiener {k:g}": partial(skimage_wiener, single, k * noise) for k in BALANCES
    }
    runs |= {f"skimage rl {count}": partial(skimage_rl, single, count) for count in stops}
    runs["skimage unsupervised"] = lambda frame: restoration.unsupervised_wiener(frame, psf, clip=False, rng=0)[0]
    if find_spec("cv2"):
        runs |= {f"opencv wiener {k:g}": _opencv(psf, shape, k * noise) for k in FLAT_BALANCES}
    if find_spec("pyproximal"):
        runs |= {f"pyproximal nnls {count}": _pyproximal(psf, shape, count) for count in stops[:2]}
    return runs


def skimage_wiener(psf: Frames, balance: float, frame: Frames) -> Any:
    """scikit-image's Wiener filter."""
    return restoration.wiener(frame, psf, balance, clip=False)


def skimage_rl(psf: Frames, count: int, frame: Frames) -> Any:
    """scikit-image's Richardson-Lucy after `count` iterations."""
    epsilon = 1e-6 * float(frame.max())
    return restoration.richardson_lucy(np.maximum(frame, 0), psf, count, clip=False, filter_epsilon=epsilon)


def _opencv(psf: Floats, shape: tuple[int, ...], balance: float) -> Restore:
    """OpenCV has transforms but no deconvolution: Wiener's filter H* / (|H|^2 + balance) on them, planned once.

    Zeros around the frame prevent its borders from wrapping round.
    """
    import cv2

    size = [cv2.getOptimalDFTSize(n + k // 2) for n, k in zip(shape, psf.shape, strict=True)]
    centred = np.zeros(size, np.float32)
    centred[: psf.shape[0], : psf.shape[1]] = psf
    centred = np.roll(centred, [-(k // 2) for k in psf.shape], axis=(0, 1))
    spectrum = cv2.dft(centred, flags=cv2.DFT_COMPLEX_OUTPUT)
    power = np.square(spectrum).sum(-1, keepdims=True)
    filter_ = np.ascontiguousarray(spectrum / (power + balance), np.float32)
    padded = np.zeros(size, np.float32)
    inverse = cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT

    def run(frame: Frames) -> Frames:
        padded[: shape[0], : shape[1]] = frame
        transformed = cv2.dft(padded, flags=cv2.DFT_COMPLEX_OUTPUT)
        image = cv2.dft(cv2.mulSpectrums(transformed, filter_, 0, conjB=True), flags=inverse)
        return np.asarray(image[: shape[0], : shape[1]])

    return run


def _pyproximal(psf: Floats, shape: tuple[int, ...], count: int) -> Restore:
    """Non-negative least squares by pyproximal's accelerated proximal gradient on pylops' convolution."""
    from pylops.signalprocessing import Convolve2D
    from pyproximal import L2, Box
    from pyproximal.optimization.primal import ProximalGradient

    blur = Convolve2D(shape, psf, offset=(psf.shape[0] // 2, psf.shape[1] // 2))
    step = 1 / float(np.abs(np.fft.fft2(psf, [2 * n for n in shape])).max()) ** 2

    def run(frame: Frames) -> Floats:
        misfit = L2(Op=blur, b=frame.astype(float).ravel())
        start = np.zeros(frame.size)
        image = ProximalGradient(misfit, Box(lower=0), start, tau=step, niter=count, acceleration="fista")
        return np.asarray(image).reshape(shape)

    return run
