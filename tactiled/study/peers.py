"""Other people's methods at settings that need no truth: scikit-image's, and OpenCV and pyproximal if installed.

scikit-image is a dependency; the others come with the extra `peers`.
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from skimage import restoration

from tactiled.study.restore import richardson_lucy, wiener
from tactiled.study.skin import Floats, Frames

Restore = Callable[[Frames], Any]

# Neither package has types.
unsupervised: Callable[..., tuple[Any, Any]] = restoration.unsupervised_wiener

BALANCES = (0.1, 0.3, 1.0)  # of Wiener filters, times the noise over the peak: 0.3 suits most scenes
FLAT_BALANCES = (0.3, 1.0, 3.0)  # the same where the filter's prior is white
STOPS = (10, 30, 100)  # iterations of those that iterate
MODULES = {"skimage": "skimage", "opencv": "cv2", "pyproximal": "pyproximal"}  # by a method's first word


def absent() -> list[str]:
    """Those of MODULES that are not installed."""
    return [name for name, module in MODULES.items() if find_spec(module) is None]


def ours(method: str) -> bool:
    """Whether a method's name is none of the peers'."""
    return method.split()[0] not in MODULES


def peers(psf: Floats, shape: tuple[int, ...], noise: float, stops: tuple[int, ...] = STOPS) -> dict[str, Restore]:
    """Every peer's restorations of frames of `shape` with `noise`, over their peak, by the odd point spread."""
    found = _skimage(psf, noise, stops)
    if find_spec("cv2"):
        found |= {f"opencv wiener {k:g}": _opencv(psf, shape, k * noise) for k in FLAT_BALANCES}
    if find_spec("pyproximal"):
        found |= {f"pyproximal nnls {count}": _pyproximal(psf, shape, count) for count in stops[:2]}
    return found


def _skimage(psf: Floats, noise: float, stops: tuple[int, ...]) -> dict[str, Restore]:
    single = psf.astype(np.float32)

    def filtered(balance: float) -> Restore:
        return lambda frame: wiener(frame, single, balance, clip=False)

    def lucy(count: int) -> Restore:
        return lambda frame: richardson_lucy(
            np.maximum(frame, 0), single, count, clip=False, filter_epsilon=1e-6 * float(frame.max())
        )

    runs: dict[str, Restore] = {f"skimage wiener {k:g}": filtered(k * noise) for k in BALANCES}
    runs["skimage unsupervised"] = lambda frame: unsupervised(frame, psf, clip=False, rng=0)[0]
    return runs | {f"skimage rl {count}": lucy(count) for count in stops}


def _opencv(psf: Floats, shape: tuple[int, ...], balance: float) -> Restore:
    """OpenCV has transforms but no deconvolution: Wiener's filter H* / (|H|^2 + balance) on them, planned once.

    Zeros around the frame keep its borders from wrapping round.
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
    back = cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT

    def run(frame: Frames) -> Frames:
        padded[: shape[0], : shape[1]] = frame
        seen = cv2.dft(padded, flags=cv2.DFT_COMPLEX_OUTPUT)
        image = cv2.dft(cv2.mulSpectrums(seen, filter_, 0, conjB=True), flags=back)
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
