# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Messages of taxels: packed bits, and which messages in a row are of one frame."""

cdef enum:
    NO_SEQUENCE = -1


def well_formed(
    const unsigned char[:, :] data,
    const unsigned char[:] lengths,
    const unsigned char[:] kinds,
    int kind,
    const unsigned char[::1] expected,
    const unsigned char[:, ::1] padding,
    long first,
    long[::1] sequences,
    long[::1] segments,
    unsigned char[::1] good,
):
    """Take the first two bytes of messages (n, W), their sequence numbers and segments; give how many are `good`.

    A message is good whose length is what is `expected` (256,) of its segment, whose kind (n,) is `kind`, and whose
    bytes from `first` on have none of the bits of `padding` (256, w), by segment. ValueError where shapes do not fit.
    """
    cdef long n = data.shape[0], width = padding.shape[1], i, j, count = 0
    cdef unsigned char wrong
    cdef const unsigned char *row
    cdef const unsigned char *pads
    if not (lengths.shape[0] == kinds.shape[0] == sequences.shape[0] == segments.shape[0] == good.shape[0] == n
            and expected.shape[0] == padding.shape[0] == 256
            and first >= 0 and data.shape[1] >= max(2, first + width) and (n == 0 or data.strides[1] == 1)):
        raise ValueError("well_formed: shapes do not fit")
    with nogil:
        for i in range(n):
            row = &data[i, 0]
            sequences[i], segments[i] = row[0], row[1]
            wrong = 0
            for j in range(width):
                wrong |= row[first + j] & padding[row[1], j]
            good[i] = not wrong and lengths[i] == expected[row[1]] and kinds[i] == kind
            count += good[i]
    return count


def unpack(const unsigned char[:, :] payloads, int bits, long taxels, unsigned short[::1] out):
    """Fill `out` (N,) with numbers of 8 to 16 bits, the least bit first, `taxels` in each row of `payloads`.

    ValueError where they do not hold as many.
    """
    cdef long rows = payloads.shape[0], width = payloads.shape[1], n = out.shape[0], at = 0, i, k, bit
    cdef unsigned int value, mask = (1u << bits) - 1
    cdef const unsigned char *byte
    if not (8 <= bits <= 16 and taxels > 0 and min(taxels, n) * bits <= 8 * width and n <= rows * taxels
            and (width == 1 or payloads.strides[1] == 1)):
        raise ValueError("unpack: payloads do not hold so many numbers")
    with nogil:
        for i in range(rows):
            for k in range(min(taxels, n - at)):
                bit = k * bits
                byte = &payloads[i, bit >> 3]
                bit &= 7
                value = byte[0]
                if bit + bits > 8:
                    value |= <unsigned int>byte[1] << 8
                if bit + bits > 16:
                    value |= <unsigned int>byte[2] << 16
                out[at] = value >> bit & mask
                at += 1


def run(
    const long[:] segments,
    const long[:] sequences,
    const double[:] times,
    const double[:] came,
    long at,
    unsigned char[::1] present,
    long missing,
    long ordered,
    const long[::1] rank,
    long length,
):
    """Take message `at` and those behind it that are of the same frame, each a segment that it lacks.

    A message ends the run that has another sequence number, or whose segment, or a later one of its group of
    `ordered`, is `present` (S,); or that is so far back in the order that a frame's segments come in, `rank` (S,),
    that it begins a new one: by half of its `length` or more. `sequences`, `came` and `rank` may be None.

    Notes what is `present`. Gives the first message not taken, the run's least and largest of `times`, the last and
    the largest of the times that they `came`, and how many come behind a later segment. IndexError where a segment
    is none of the frame's, ValueError where shapes do not fit.
    """
    cdef long n = segments.shape[0], size = present.shape[0], i, k, highest = -1, late = 0, before
    cdef double first, last, newest = 0
    if not (0 <= at < n == times.shape[0] and ordered > 0 and (sequences is None or sequences.shape[0] == n)
            and (came is None or came.shape[0] == n) and (rank is None or rank.shape[0] == size)):
        raise ValueError("run: shapes do not fit")
    for i in range(at, n):
        if not 0 <= segments[i] < size:
            raise IndexError(f"segment {segments[i]} of {size}")
    for k in range(size):
        if present[k]:
            highest = k
    first = last = times[at]
    if came is not None:
        newest = came[at]
    i = at
    while True:
        k = segments[i]
        present[k] = True
        late += k < highest
        highest = max(highest, k)
        first, last = min(first, times[i]), max(last, times[i])
        if came is not None:
            newest = max(newest, came[i])
        missing -= 1
        i += 1
        if i == n or missing <= 0:
            break
        if sequences is not None and (sequences[i] != sequences[i - 1] or sequences[i] == NO_SEQUENCE):
            break
        before, k = k, segments[i]
        if rank is not None and 2 * (rank[before] - rank[k]) >= length:
            break
        while not present[k] and k + 1 < size and (k + 1) % ordered:
            k += 1
        if present[k]:
            break
    return i, first, last, 0.0 if came is None else came[i - 1], newest, late
