# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Peaks of an image, frames of small loads, and steps of a fit of those to a frame."""

from libc.math cimport fabs, rint, sqrt
from libc.stdlib cimport calloc, free, malloc
from libc.string cimport memcpy

cdef extern from "products.h" nogil:
    void product(long m, long n, long l, const float *a, long down, long across, const float *b, float *out)

cdef enum:
    PIECE = 256  # taxels that are summed in single precision


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
    cdef long C = (across.shape[3] - 1) // 2, n = at.shape[0], i
    if not (phases and down.shape[1] == across.shape[1] == 3 and across.shape[0] == phases
            and across.shape[2] == parts and at.shape[1] == 2 and out.shape[1] == n and out.shape[2] == R * C
            and 0 <= first and first + out.shape[0] <= 4):
        raise ValueError("responses: shapes do not fit")
    for i in range(n):
        if not (-phases <= at[i, 0] <= R * phases and -phases <= at[i, 1] <= C * phases):
            raise ValueError("responses: a load is off the table")
    if fill(down, across, &at[0, 0], n, first, out.shape[0], &out[0, 0, 0]) < 0:
        raise MemoryError


cdef int fill(
    const float[:, :, :, ::1] down,
    const float[:, :, :, ::1] across,
    const long *at,
    long n,
    long first,
    long kinds,
    float *out,
) noexcept nogil:
    """Fill out (kinds, n, R C) as `responses` does; -1 where there is no memory."""
    cdef long phases = down.shape[0], parts = down.shape[2], wide = down.shape[3], widest = across.shape[3]
    cdef long R = (wide - 1) // 2, C = (widest - 1) // 2, cells = parts * C
    cdef long i, k, p, order, behind_row, behind_column
    cdef float *a = <float *>malloc((3 * cells + R * C) * sizeof(float))
    if a == NULL:
        return -1
    cdef float *bends = a + 3 * cells
    cdef const float *d
    cdef const float *values
    cdef float *drawn
    for i in range(n):
        # Taxel r sees the load place - r away; the tables run backwards, so that r runs forwards.
        behind_row, behind_column = R * phases - at[2 * i], C * phases - at[2 * i + 1]
        d = &down[behind_row % phases, 0, 0, 0] + behind_row // phases
        values = &across[behind_column % phases, 0, 0, 0] + behind_column // phases
        for p in range(3 * parts):
            memcpy(a + p * C, values + p * widest, C * sizeof(float))
        for k in range(kinds):
            drawn = out + (k * n + i) * R * C
            order = parts * wide * ((first + k == 1) + 2 * (first + k == 3))
            product(R, C, parts, d + order, 1, wide, a + cells * (first + k == 2), drawn)
            if first + k == 3:
                product(R, C, parts, d, 1, wide, a + 2 * cells, bends)
                for p in range(R * C):
                    drawn[p] = 0.5 * (drawn[p] + bends[p])
    free(a)
    return 0


def fit(
    const float[:, :, :, ::1] down,
    const float[:, :, :, ::1] across,
    const float[::1] y,
    double[:, ::1] places,
    long n,
    double variance,
    long steps,
    const double[::1] limits,
    float[:, ::1] jacobian,
    float[::1] left,
    double[:, ::1] found,
):
    """Fit n loads at `places` (most, 2) pitches to a frame y (N,) of noise of a `variance`: Gauss-Newton steps.

    `down` and `across` are as of `responses`. Every step is from the nearest tabulated places: forces f are the
    least of |y - J_n' f|^2, moves those of the linear fit to what these leave, for the Jacobian J of the frames of
    unit loads and their slopes. `limits`: a load is left out whose force is shown by less than the first of them,
    its frame's norm; the steps end with moves below the second, in pitches, or after so many `steps`; none is
    longer than the third. Squares are larger by the fourth, so that what no frame can tell apart is only very
    uncertain. The last step is linear, in widths too (kinds of `responses`), which a normal prior holds near their
    common one w, of deviation fifth + sixth w.

    Gives the steps made; the loads, 0 where too little force is left at the last places; w and its variance for a
    noise of 1. Fills `places` with the last ones, `left` (N,) with what the last step leaves of y, and `found`
    (10, most): forces; the last step's change of force, row, column, and its width (square pitches); widths held
    near no other, and their variance for a noise of 1; and that of force, row and column. `jacobian` (4 most, N) is
    memory. ValueError where shapes do not fit.
    """
    cdef long N = y.shape[0], most = places.shape[0], phases = down.shape[0], rows, columns, i, j, k, done, m, clear
    if not (phases and across.shape[0] == phases and down.shape[1] == across.shape[1] == 3
            and across.shape[2] == down.shape[2]):
        raise ValueError("fit: shapes do not fit")
    rows, columns = (down.shape[3] - 1) // 2, (across.shape[3] - 1) // 2
    if not (0 < n <= most and N == rows * columns and places.shape[1] == 2 and limits.shape[0] == 6
            and jacobian.shape[0] >= 4 * most and jacobian.shape[1] == N and left.shape[0] == N
            and found.shape[0] == 10 and found.shape[1] == most):
        raise ValueError("fit: shapes do not fit")
    cdef long size = 4 * most, spare = size * (4 * size + 5)
    cdef double *system = <double *>malloc(spare * sizeof(double) + most * 2 * sizeof(long))
    if system == NULL:
        raise MemoryError
    cdef long *at = <long *>(system + spare)
    cdef double *scale = system + size * (4 * size + 3)
    cdef double *moved = scale + size
    cdef double move, longest, common = 0, common_variance = 0
    cdef double[2] end
    cdef float *J = &jacobian[0, 0]
    cdef bint failed = False
    end[0], end[1] = rows - 0.5, columns - 0.5
    with nogil:
        for i in range(n):
            for k in range(2):
                places[i, k] = min(places[i, k], end[k]) if places[i, k] > -0.5 else -0.5
        for done in range(1, steps + 1):
            for i in range(n):
                for k in range(2):
                    at[2 * i + k] = <long>rint(places[i, k] * phases)
                    places[i, k] = at[2 * i + k] / <double>phases
            m = 3 * n
            failed = fill(down, across, at, n, 0, 3, J) < 0 or squares(J, &y[0], m, N, system) < 0
            if failed:
                break
            step(system, n, limits[3], system + size * (size + 1), &found[0, 0], moved)
            clear, longest = 0, 0
            for i in range(n):
                if found[0, i] * sqrt(system[i * (m + 2)]) > limits[0]:
                    places[clear, 0], places[clear, 1] = places[i, 0], places[i, 1]
                    clear += 1
                longest = max(longest, fabs(moved[i]), fabs(moved[n + i]))
            if clear < n:
                n = clear
                if n == 0:
                    break
                continue
            if done == steps or longest < limits[1]:
                break
            for i in range(n):
                for k in range(2):
                    move = places[i, k] + min(max(moved[k * n + i], -limits[2]), limits[2])
                    places[i, k] = min(move, end[k]) if move > -0.5 else -0.5
        else:
            done, n = steps, 0
        if n and not failed:
            m = 4 * n
            failed = fill(down, across, at, n, 3, 1, J + 3 * n * N) < 0
            for i in range(n):
                scale[i], scale[n + i], scale[2 * n + i], scale[3 * n + i] = 1, found[0, i], found[0, i], found[0, i]
                for k in range(3):
                    moved[k * n + i] = 0
            for i in range(n):
                moved[i] = found[0, i]
            take_away(&y[0], J, moved, n, N, &left[0])
            failed = squares(J, &left[0], m, N, system) < 0 or failed
            for i in range(m):
                for j in range(m + 1):
                    system[i * (m + 1) + j] *= scale[i] * (scale[j] if j < m else 1)
                system[i * (m + 2)] *= 1 + limits[3]
            common_variance = widths(system, n, system + size * (size + 1), &found[0, 0], most)
            for i in range(n):
                common += found[5, i] / found[6, i] * common_variance
            common = max(common, 0)
            last(system, n, common, variance / (limits[4] + limits[5] * common) ** 2, system + size * (size + 1),
                 &found[0, 0], most)
            for i in range(n):
                for k in range(4):
                    moved[k * n + i] = found[1 + k, i] * scale[k * n + i]
            take_away(&left[0], J, moved, m, N, &left[0])
        free(system)
    if failed:
        raise MemoryError
    return done, n, common, common_variance


cdef int squares(const float *J, const float *y, long m, long N, double *out) noexcept nogil:
    """Fill out (m, m + 1) with J J' and J y of a Jacobian J (m, N); -1 where there is no memory."""
    cdef long i, j, size, first = 0
    cdef float *turned = <float *>malloc((PIECE + m) * (m + 1) * sizeof(float))  # of J and y, N after m + 1
    cdef float *part = turned + PIECE * (m + 1)
    for i in range(m * (m + 1)):
        out[i] = 0
    if turned == NULL:
        return -1
    while first < N:
        size = min(PIECE, N - first)
        for j in range(size):
            for i in range(m):
                turned[j * (m + 1) + i] = J[i * N + first + j]
            turned[j * (m + 1) + m] = y[first + j]
        product(m, m + 1, size, J + first, N, 1, turned, part)
        for i in range(m * (m + 1)):
            out[i] += part[i]
        first += PIECE
    free(turned)
    return 0


cdef void step(const double *system, long n, double ridge, double *A, double *force, double *moves) noexcept nogil:
    """Fill `force` (n,) and `moves` (2 n,) of a step by a `system` (3 n, 3 n + 1) of squares; A is memory."""
    cdef long m = 3 * n, i, j
    cdef double *change = A + m * m
    cdef double total
    for i in range(n):
        for j in range(n):
            A[i * n + j] = system[i * (m + 1) + j] * (1 + ridge * (i == j))
        force[i] = system[i * (m + 1) + m]
    solve(A, force, n)
    for i in range(m):
        total = system[i * (m + 1) + m]
        for j in range(n):
            total -= system[i * (m + 1) + j] * force[j]
        change[i] = total
        for j in range(m):
            A[i * m + j] = system[i * (m + 1) + j] * (1 + ridge * (i == j))
    solve(A, change, m)
    for i in range(n):
        moves[i], moves[n + i] = change[n + i] / force[i], change[2 * n + i] / force[i]


cdef double widths(const double *system, long n, double *A, double *found, long most) noexcept nogil:
    """Fill widths of loads, held near no other, and their variance; gives the variance of their weighted mean."""
    cdef long m = 4 * n, i, j
    cdef double *inverse = A + m * m
    cdef double total, weight = 0
    for i in range(m):
        for j in range(m):
            A[i * m + j] = system[i * (m + 1) + j]
    invert(A, inverse, m)
    for i in range(n):
        total = 0
        for j in range(m):
            total += inverse[(3 * n + i) * m + j] * system[j * (m + 1) + m]
        found[5 * most + i], found[6 * most + i] = total, max(inverse[(3 * n + i) * (m + 1)], 1e-30)
        weight += 1 / found[6 * most + i]
    return 1 / weight


cdef void last(
    const double *system, long n, double width, double firm, double *A, double *found, long most
) noexcept nogil:
    """Fill the last step, its widths held near one by so `firm` a precision, and the variance of force and place."""
    cdef long m = 4 * n, i, j
    cdef double *inverse = A + m * m
    cdef double total
    for i in range(m):
        for j in range(m):
            A[i * m + j] = system[i * (m + 1) + j] + (firm if i == j >= 3 * n else 0)
    invert(A, inverse, m)
    for i in range(m):
        total = 0
        for j in range(m):
            total += inverse[i * m + j] * (system[j * (m + 1) + m] + (firm * width if j >= 3 * n else 0))
        found[(1 + i // n) * most + i % n] = total
        if i < 3 * n:
            found[(7 + i // n) * most + i % n] = inverse[i * (m + 1)]


cdef void take_away(const float *y, const float *J, const double *of, long m, long N, float *out) noexcept nogil:
    """Fill out (N,) with y - J' `of` of m rows of J; `out` may be y."""
    cdef long i, p
    cdef float by
    for p in range(N):
        out[p] = y[p]
    for i in range(m):
        by = of[i]
        for p in range(N):
            out[p] -= by * J[i * N + p]


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


cdef void invert(double *A, double *out, long n) noexcept nogil:
    """Fill `out` with the inverse of a positive definite A (n, n), which is lost."""
    cdef long i, j, k
    cdef double factor
    for i in range(n):
        for j in range(n):
            out[i * n + j] = i == j
    for k in range(n):
        factor = 1 / A[k * n + k]
        for j in range(n):
            A[k * n + j] *= factor
            out[k * n + j] *= factor
        for i in range(n):
            if i != k:
                factor = A[i * n + k]
                for j in range(n):
                    A[i * n + j] -= factor * A[k * n + j]
                    out[i * n + j] -= factor * out[k * n + j]
