# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Where a surface is pressed, and what lies beyond the taxels there, float32."""


def box(const float[::1] y, const int[::1] rows, const int[::1] columns, float threshold, int margin):
    """Find where taxels read more than a threshold: at `rows` and `columns` (N,), `margin` more on each side.

    Gives first and last row, first and last column; of the taxels elsewhere the number, sum and sum of squares of what
    they read; and that of all. The last row is before the first where none of `y` (N,) reads more. NaN is more.
    """
    cdef long n
    cdef int top = 0, bottom = -1, left = 0, right = -1, count = 0, outside
    cdef float total = 0, squares = 0, power = 0, value
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
        if bottom >= 0:
            top, bottom, left, right = top - margin, bottom + margin, left - margin, right + margin
        for n in range(y.shape[0]):
            outside = (rows[n] < top) | (rows[n] > bottom) | (columns[n] < left) | (columns[n] > right)
            value = y[n] if outside else 0
            count += outside
            total += value
            squares += value * value
            power += y[n] * y[n]
    return top, bottom, left, right, count, total, squares, power


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
