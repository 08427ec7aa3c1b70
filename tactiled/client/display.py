"""Arrays as pictures in the HTML of a notebook, without a library of pictures."""

from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from html import escape
from struct import pack
from zlib import compress, crc32

import numpy as np

from tactiled.arrays import Flags, Floats32

LEVELS = 254  # greys; two colours for NaN follow
NAN_COLORS = (200, 0, 0), (255, 255, 255)
PICTURE_PIXELS, MIN_CELL_PIXELS = 256, 4  # of the longer side, as far as cells allow
MIN_TOP_SIGMAS = 10.0  # noise standard deviations: on a shorter scale noise would look like a load


@cache
def palette() -> Flags:
    """256 colours (256, 3): greys in equal steps of CIELAB's lightness from black to white, and those of NaN."""
    lightness = np.linspace(0.0, 100.0, LEVELS)
    luminance = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness * 27 / 24389)
    grey = np.where(luminance <= 0.0031308, 12.92 * luminance, 1.055 * luminance ** (1 / 2.4) - 0.055)  # sRGB
    return np.vstack([np.tile(255 * grey[:, None], 3).round(), NAN_COLORS]).astype(np.uint8)


def png(values: Floats32, top: float) -> bytes:
    """A PNG of an image (rows, columns): black at 0, white from `top` on; NaN is hatched in red."""
    side = max(MIN_CELL_PIXELS, PICTURE_PIXELS // max(values.shape))
    pixels = np.kron(values, np.ones((side, side), np.float32))
    y, x = np.indices(pixels.shape)
    levels = np.nan_to_num(pixels * ((LEVELS - 1) / top)).clip(0, LEVELS - 1).round()
    indices = np.where(np.isnan(pixels), LEVELS + (x + y) // 2 % 2, levels).astype(np.uint8)
    chunks = {
        b"IHDR": pack(">IIBBBBB", *pixels.shape[::-1], 8, 3, 0, 0, 0),  # each pixel a byte: its colour's number
        b"PLTE": palette().tobytes(),
        b"IDAT": compress(np.insert(indices, 0, 0, axis=1).tobytes()),  # 0 before each row: no filter
        b"IEND": b"",
    }
    coded = (pack(">I", len(data)) + name + data + pack(">I", crc32(name + data)) for name, data in chunks.items())
    return b"\x89PNG\r\n\x1a\n" + b"".join(coded)


def html(title: str, images: Mapping[str, Floats32], unit: str, noise: float, facts: Mapping[str, object]) -> str:
    """Images (rows, columns) or (taxels,) in `unit` on one scale of greys, over a table of facts."""
    peaks = {name: float(np.fmax.reduce(image, axis=None, initial=np.nan)) for name, image in images.items()}
    top = float(np.fmax.reduce([*peaks.values(), MIN_TOP_SIGMAS * noise, 1e-6]))
    cells = ""
    for name, image in images.items():
        data = b64encode(png(np.atleast_2d(image), top)).decode()
        caption = f"{name}, peak {peaks[name]:.4g} {unit}"
        cells += f'<td>{caption}<br><img alt="{caption}" src="data:image/png;base64,{data}"></td>'
    scale = {"black to white": f"0 to {top:.4g} {unit}; hatched in red: no data"}
    rows = (f"<tr><th>{key}</th><td>{escape(str(fact))}</td></tr>" for key, fact in {**facts, **scale}.items())
    return f"<b>{escape(title)}</b><table><tr>{cells}</tr></table><table>{''.join(rows)}</table>"
