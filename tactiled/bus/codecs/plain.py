"""What skins of classic messages without sequence numbers have in common; not a codec itself."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import CodecError
from tactiled.frames import Counts


class Plain:
    """Segments of `taxels` taxels each, the last perhaps of fewer, that always come in order."""

    taxels: int  # in a segment

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        raise NotImplementedError

    @property
    def full_scale(self) -> int:
        """Largest count."""
        raise NotImplementedError

    @property
    def segments(self) -> int:
        """Messages in a whole frame."""
        return -(-self.size // self.taxels)

    @property
    def modulus(self) -> None:
        """None: these skins send no sequence number."""
        return

    @property
    def ordered(self) -> int:
        """Segments that come in order: all."""
        return self.segments

    def span(self, segment: int) -> slice | list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return slice(segment * self.taxels, min((segment + 1) * self.taxels, self.size))

    def stacked(self, payloads: Sequence[bytes | None], length: int) -> NDArray[np.uint8]:
        """The payloads of a frame (segments, length), 0 where one is None."""
        blank = bytes(length)
        whole = b"".join(blank if each is None else each for each in payloads)
        return np.frombuffer(whole, np.uint8).reshape(-1, length)

    def checked(self, counts: Counts) -> NDArray[np.uint16]:
        """The counts of one frame (N,), which the skin can say; CodecError where it cannot."""
        whole = np.asarray(counts, np.uint16)
        if whole.shape != (self.size,) or int(whole.max()) > self.full_scale:
            raise CodecError(
                f"counts {whole.shape} up to {whole.max()}: expected {self.size} up to {self.full_scale}"
            )
        return whole
