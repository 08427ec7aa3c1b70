# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Where a surface is pressed, and what lies beyond the taxels there, float32."""

from libc.math cimport sqrt


def box(
    const float[::1] y,
    const int[::1] rows,
    const int[::1] columns,
    (int, int, int, int) ends,
    (int, int) shape,
    float threshold,
    int margin,
    float noise,
    float sigmas,
    float hidden,
):
    """Find the box on a surface (R, C) that all of a frame y (N,) is in, of taxels at `rows` and `columns` (N,).

    `ends` are the first and last of those rows and of those columns.
    It is around the taxels that read more than a threshold, NaN too, with a `margin` of cells on each side; it goes
    to the end of the surface where it has the outermost taxels. It is the whole surface unless what the n taxels
    outside read is as noise is: squares whose sum is within `sigmas` sqrt(2 n) of n, a sum within `sigmas` sqrt(n),
    in standard deviations `noise`; and the pressure that this could hide, the square root of the first, has no
    norm above `hidden` times the frame's.
    Gives first row, end of rows, first column, end of columns, and whether the box ends before all outermost taxels.
    """
    cdef long n
    cdef int top = 0, bottom = -1, left = 0, right = -1, outside
    cdef int low = ends[0], high = ends[1], first = ends[2], last = ends[3]
    cdef float count = 0, total = 0, squares = 0, power = 0, value, stray
    if not y.shape[0] == rows.shape[0] == columns.shape[0]:
        raise ValueError("box: shapes do not fit")
    with nogil:
        for n in range(y.shape[0]):
            if y[n] <= threshold:
                continue
            if bottom < 0:
                top, bottom, left, right = rows[n], rows[n], columns[n], columns[n]
            top, bottom = min(top, rows[n]), max(bottom, rows[n])
            left, right = min(left, columns[n]), max(right, columns[n])
        top, bottom, left, right = top - margin, bottom + margin, left - margin, right + margin
        for n in range(y.shape[0]):
            outside = (rows[n] < top) | (rows[n] > bottom) | (columns[n] < left) | (columns[n] > right)
            value = y[n] if outside else 0
            count += outside
            total += value
            squares += value * value
            power += y[n] * y[n]
        noise *= noise
        stray = noise * sigmas * sqrt(2 * count)
    if (
        bottom < margin or not squares < noise * count + stray
        or not total * total < sigmas * sigmas * noise * count or stray > hidden * hidden * power
    ):
        return 0, shape[0], 0, shape[1], False
    return (
        top if top > low else 0,
        bottom + 1 if bottom < high else shape[0],
        left if left > first else 0,
        right + 1 if right < last else shape[1],
        low < top and bottom < high and first < left and right < last,
    )


def complete(
    const float[:, ::1] matrix,
    const float[:, ::1] y,
    const long[::1] rows,
    const long[::1] columns,
    long top,
    long left,
    (long, long, long, long) box,
    float[:, ::1] frame,
):
    """Fill a frame (R, C) beyond an array's own y (r, c), which lies in it from row `top`, column `left` on.

    Of the m cells at `rows` and `columns` those in the `box` (rows from, to, columns from, to) get `matrix` (m, r c)
    times what the taxels in it read, and the others zero. ValueError where shapes do not fit.
    """
    cdef long m = matrix.shape[0], r = y.shape[0], c = y.shape[1], k, i, j
    cdef long first = max(box[0] - top, 0), last = min(box[1] - top, r)
    cdef long low = max(box[2] - left, 0), high = min(box[3] - left, c)
    cdef float total
    cdef const float *weights
    if not (
        m == rows.shape[0] == columns.shape[0] and matrix.shape[1] == r * c
        and 0 <= top and top + r <= frame.shape[0] and 0 <= left and left + c <= frame.shape[1]
    ):
        raise ValueError("complete: shapes do not fit")
    for k in range(m):
        if not (0 <= rows[k] < frame.shape[0] and 0 <= columns[k] < frame.shape[1]):
            raise ValueError("complete: a cell is not in the frame")
    with nogil:
        for i in range(r):
            for j in range(c):
                frame[top + i, left + j] = y[i, j]
        for k in range(m):
            total = 0
            if box[0] <= rows[k] < box[1] and box[2] <= columns[k] < box[3]:
                for i in range(first, last):
                    weights = &matrix[k, i * c]
                    for j in range(low, high):
                        total += weights[j] * y[i, j]
            frame[rows[k], columns[k]] = total
