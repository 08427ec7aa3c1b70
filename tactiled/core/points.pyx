# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Peaks of an image, frames of small loads, and steps of a fit of those to a frame."""

from libc.math cimport fabs, sqrt
from libc.stdlib cimport calloc, free, malloc
from libc.string cimport memcpy

cdef extern from "products.h" nogil:
    void product(long m, long n, long l, const float *a, long down, long across, const float *b, float *out)


def peaks(const float[:, :] image, long reach, float remainder, double near, double[:, ::1] places):
    """Fill `places` (most, 2) with an image's peaks, in cells; gives their number and what tells whether they are all.

    The highest cell and its neighbours, up to `reach` rows and columns away, are taken away, time after time, until
    no more than a `remainder` of the image (R, C) is left, or `places` are full: their centroid is a place. Gives
    also how many pairs are less than `near` apart in rows and in columns, the image's sum, its sum of squares, and
    the sum of what is left. No value may be below zero. ValueError where rows are not in one piece.
    """
    cdef long R = image.shape[0], C = image.shape[1], width = C + 2 * reach, most = places.shape[0]
    cdef long i, j, k, found = 0, pairs = 0, row, column
    cdef double total = 0, squares = 0, left, weight, down, across
    cdef float value
    if not (R and C and reach >= 0 and places.shape[1] == 2 and (C == 1 or image.strides[1] == sizeof(float))):
        raise ValueError("peaks: shapes do not fit")
    cdef float *cells = <float *>calloc((R + 2 * reach) * width + R, sizeof(float))  # and zeros around
    if cells == NULL:
        raise MemoryError
    cdef float *highest = cells + (R + 2 * reach) * width  # of each row
    with nogil:
        for i in range(R):
            memcpy(cells + (reach + i) * width + reach, &image[i, 0], C * sizeof(float))
            for j in range(C):
                value = image[i, j]
                total += value
                squares += value * value
            highest[i] = highest_of(&image[i, 0], C)
        left = total
        while left > remainder * total and found < most:
            row = column = 0
            for i in range(R):
                if highest[i] > highest[row]:
                    row = i
            while column + 1 < C and cells[(reach + row) * width + reach + column] < highest[row]:
                column += 1
            weight = down = across = 0
            for i in range(row, row + 2 * reach + 1):
                for j in range(column, column + 2 * reach + 1):
                    value = cells[i * width + j]
                    weight += value
                    down += (i - reach) * value
                    across += (j - reach) * value
                    cells[i * width + j] = 0
            if not weight > 0:
                break
            for i in range(max(row - reach, 0), min(row + reach + 1, R)):
                highest[i] = highest_of(cells + (reach + i) * width + reach, C)
            left -= weight
            places[found, 0], places[found, 1] = down / weight, across / weight
            for k in range(found):
                pairs += (fabs(places[k, 0] - places[found, 0]) < near
                          and fabs(places[k, 1] - places[found, 1]) < near)
            found += 1
        free(cells)
    return found, pairs, total, squares, left


cdef float highest_of(const float *x, long n) noexcept nogil:
    cdef long i
    cdef float highest = x[0]
    for i in range(1, n):
        highest = x[i] if x[i] > highest else highest
    return highest


def responses(
    const float[:, :, :, ::1] down,
    const float[:, :, :, ::1] across,
    const long[:, ::1] at,
    int first,
    float[:, :, ::1] out,
):
    """Fill out (k, n, R C) with k of four kinds of frames of unit loads, the kind `first` and those behind it.

    A frame is sum_p d_p x a_p, of factors that are tabulated by the distance of taxel and load: `down` (phases, 3,
    parts, 2 R + 1) and `across` (phases, 3, parts, 2 C + 1) hold them, their slopes and their curvatures at
    distances from R, or C, down by one pitch each, and less by a phase. Loads are `at` (n, 2) phases down and
    across from the first taxel. The kinds are the frames themselves, their slopes down and across, and half the
    sum of the second derivatives. ValueError where shapes do not fit.
    """
    cdef long phases = down.shape[0], parts = down.shape[2], R = (down.shape[3] - 1) // 2
    cdef long C = (across.shape[3] - 1) // 2, n = at.shape[0], i, k
    if not (phases and down.shape[1] == across.shape[1] == 3 and across.shape[0] == phases
            and across.shape[2] == parts and at.shape[1] == 2 and out.shape[1] == n and out.shape[2] == R * C
            and 0 <= first and first + out.shape[0] <= 4):
        raise ValueError("responses: shapes do not fit")
    for i in range(n):
        if not (-phases <= at[i, 0] <= R * phases and -phases <= at[i, 1] <= C * phases):
            raise ValueError("responses: a load is off the table")
    cdef long wide = down.shape[3], widest = across.shape[3], cells = parts * C, p, order, behind_row, behind_column
    cdef float *a = <float *>malloc((3 * cells + R * C) * sizeof(float))
    if a == NULL:
        raise MemoryError
    cdef float *bends = a + 3 * cells
    cdef const float *d
    cdef const float *values
    with nogil:
        for i in range(n):
            # Taxel r sees the load place - r away; the tables run backwards, so that r runs forwards.
            behind_row, behind_column = R * phases - at[i, 0], C * phases - at[i, 1]
            d = &down[behind_row % phases, 0, 0, 0] + behind_row // phases
            values = &across[behind_column % phases, 0, 0, 0] + behind_column // phases
            for p in range(3 * parts):
                memcpy(a + p * C, values + p * widest, C * sizeof(float))
            for k in range(out.shape[0]):
                order = parts * wide * ((first + k == 1) + 2 * (first + k == 3))
                product(R, C, parts, d + order, 1, wide, a + cells * (first + k == 2), &out[k, i, 0])
                if first + k == 3:
                    product(R, C, parts, d, 1, wide, a + 2 * cells, bends)
                    for p in range(R * C):
                        out[k, i, p] = 0.5 * (out[k, i, p] + bends[p])
        free(a)


def step(const double[:, ::1] gram, const double[::1] along, double ridge, double[:, ::1] out):
    """Fill `out` (4, n) with the forces of n loads, how well they show, and how far the loads move to fit a frame.

    Of a Jacobian J (3 n, N), which has the frames of unit loads, then their slopes down, then those across, `gram`
    is J J' and `along` J y. Forces f are the least of |y - J_n' f|^2, moves those of the linear fit to what these
    leave, each over its force; a force shows by the norm of its load's frame. Squares are by 1 + `ridge` larger, so
    that what no frame can tell apart is only very uncertain. ValueError where shapes do not fit.
    """
    cdef long n = out.shape[1], m = 3 * n, i, j
    cdef double total
    if not (n and out.shape[0] == 4 and gram.shape[0] == gram.shape[1] == along.shape[0] == m):
        raise ValueError("step: shapes do not fit")
    cdef double *firm = <double *>malloc((m * m + m) * sizeof(double))  # with the ridge
    if firm == NULL:
        raise MemoryError
    cdef double *change = firm + m * m
    with nogil:
        for i in range(n):
            for j in range(n):
                firm[i * n + j] = gram[i, j] * (1 + ridge * (i == j))
            change[i] = along[i]
        solve(firm, change, n)
        for i in range(n):
            out[0, i], out[1, i] = change[i], sqrt(gram[i, i])
        for i in range(m):
            total = along[i]
            for j in range(n):
                total -= gram[i, j] * out[0, j]
            change[i] = total
            for j in range(m):
                firm[i * m + j] = gram[i, j] * (1 + ridge * (i == j))
        solve(firm, change, m)
        for i in range(n):
            out[2, i], out[3, i] = change[n + i] / out[0, i], change[2 * n + i] / out[0, i]
        free(firm)


cdef void solve(double *A, double *b, long n) noexcept nogil:
    """Solve A x = b in place, x for b, for a positive definite A (n, n)."""
    cdef long i, j, k
    cdef double factor
    for k in range(n):
        for i in range(k + 1, n):
            factor = A[i * n + k] / A[k * n + k]
            for j in range(k + 1, n):
                A[i * n + j] -= factor * A[k * n + j]
            b[i] -= factor * b[k]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= A[i * n + j] * b[j]
        b[i] /= A[i * n + i]
