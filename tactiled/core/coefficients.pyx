# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Images and frames in the modes of a blur, float32: their coefficients, and what those tell of a scene."""

from libc.math cimport INFINITY, NAN
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy

cdef extern from "products.h" nogil:
    void product(long m, long n, long l, const float *a, long down, long across, const float *b, float *out)

cdef extern from "looks.h" nogil:
    struct looks:
        float highest, above, above_squared, below_squared

    looks look_at(long n, const float *x)
    float dot(long n, const float *a, const float *b)
    int window_means(const float *x, long rows, long columns, float *out)
    bint any_above(long n, float *values, float variance, float level, const float *limit)

cdef float MOST = 1e18  # of a power over the noise's: more overflows, and changes nothing


def transform(const float[:, ::1] left, const float[:, ::1] x, const float[:, ::1] right, float[:, ::1] out):
    """Fill `out` (m, n) with left (m, R) x (R, C) right (C, n); ValueError where shapes do not fit."""
    cdef long m = left.shape[0], R = left.shape[1], C = right.shape[0], n = right.shape[1]
    if not (m and n and R and C and x.shape[0] == R and x.shape[1] == C and out.shape[0] == m and out.shape[1] == n):
        raise ValueError("transform: shapes do not fit")
    cdef float *between = <float *>malloc(m * C * sizeof(float))
    if between == NULL:
        raise MemoryError
    with nogil:
        product(m, C, R, &left[0, 0], R, 1, &x[0, 0], between)
        product(m, n, C, between, C, 1, &right[0, 0], &out[0, 0])
        free(between)


def likeliest(
    const float[:, ::1] left,
    const float[:, ::1] frame,
    const float[:, ::1] right,
    const long[::1] row_blocks,
    const long[::1] column_blocks,
    const float[:, ::1] costs,
):
    """Give the row s of `costs` (S, B + 1) with the least sum_b costs[s, b] power_b + costs[s, B].

    power_b is the sum of the squares of left (m, R) frame (R, C) right (C, n) in each of B blocks, row after row:
    those begin at the rows and columns `row_blocks` and `column_blocks`. ValueError where shapes do not fit.
    """
    cdef long m = left.shape[0], R = left.shape[1], C = right.shape[0], n = right.shape[1]
    cdef long down = row_blocks.shape[0], across = column_blocks.shape[0], B = down * across, S = costs.shape[0]
    cdef long i, j, k, block, best = 0
    cdef float cost, least = INFINITY, total
    if not (m and n and R and C and down and across and S and frame.shape[0] == R and frame.shape[1] == C
            and costs.shape[1] == B + 1
            and row_blocks[0] == column_blocks[0] == 0 and row_blocks[down - 1] < m and column_blocks[across - 1] < n):
        raise ValueError("likeliest: shapes do not fit")
    cdef float *between = <float *>malloc((m * C + m * n + B) * sizeof(float))
    if between == NULL:
        raise MemoryError
    cdef float *modes = between + m * C
    cdef float *power = modes + m * n
    with nogil:
        product(m, C, R, &left[0, 0], R, 1, &frame[0, 0], between)
        product(m, n, C, between, C, 1, &right[0, 0], modes)
        for block in range(B):
            power[block] = 0
        block = 0
        for i in range(m):
            if block + 1 < down and row_blocks[block + 1] <= i:
                block += 1
            for k in range(across):
                total = 0
                for j in range(column_blocks[k], column_blocks[k + 1] if k + 1 < across else n):
                    total += modes[i * n + j] * modes[i * n + j]
                power[block * across + k] += total
        for i in range(S):
            cost = costs[i, B]
            for j in range(B):
                cost += costs[i, j] * power[j]
            if cost < least:
                least, best = cost, i
        free(between)
    return best


def analyse(
    const float[:, ::1] left, const float[:, ::1] x, const float[:, ::1] right, const float[::1] total,
    float[:, ::1] out,
):
    """As `transform`; gives the sum of `total` (m n,) times the coefficients, and that of their squares."""
    transform(left, x, right, out)
    cdef long n = out.shape[0] * out.shape[1]
    cdef float summed, squares
    if total.shape[0] != n:
        raise ValueError("analyse: shapes do not fit")
    with nogil:
        summed, squares = dot(n, &total[0], &out[0, 0]), dot(n, &out[0, 0], &out[0, 0])
    return summed, squares


def filtered(
    const float[:, ::1] c,
    float variance,
    const float[:, :, ::1] of_spectrum,
    const float[:, :, ::1] of_modes,
    const float[::1] shared,
    const float[::1] total,
    const float[:, ::1] left,
    const float[:, ::1] right,
    float[:, ::1] weight,
    float[:, ::1] out,
):
    """Fill `out` (R, C) with left (R, K) (W c) right (L, C) of coefficients c (K, L), and `weight` with W of each.

    W is the second of `of_spectrum` (2, K, L), but for modes that stand out of the spectrum. With powers over the
    noise's `variance`, p the mean of c^2 in a window of 5 x 5 modes, a mode stands out where p > the first of
    `of_spectrum` times q: the most of 1, the mean of c^2 by weights, and what rows and columns share, 1 + a d + b e.
    d (K,) and e (L,) follow one another in `shared`; a and b: by how much the median of c^2 in the upper half of the
    first row, or column, is above noise's. Then W = s r / (s f + 1) with s = max(p - 1, 0). The weights, r and f are
    `of_modes` (3, K, L).

    Gives the sum of W^2, that of `total` (K L,) W c, and of `out` the sum and the sum of squares of what is above 0,
    the sum of squares of what is below, and the highest. ValueError where shapes do not fit.
    """
    cdef long K = c.shape[0], L = c.shape[1], R = left.shape[0], C = right.shape[1], size = K * L, i, j, at
    cdef bint failed
    cdef float level, a, b, q, p, own, felt
    cdef looks seen
    if not (
        K and L and R and C and of_spectrum.shape[0] == 2 and of_modes.shape[0] == 3
        and of_spectrum.shape[1] == of_modes.shape[1] == weight.shape[0] == left.shape[1] == K
        and of_spectrum.shape[2] == of_modes.shape[2] == weight.shape[1] == right.shape[0] == L
        and shared.shape[0] == K + L and total.shape[0] == size and out.shape[0] == R and out.shape[1] == C
    ):
        raise ValueError("filtered: shapes do not fit")
    cdef float *squares = <float *>malloc((2 * size + R * L) * sizeof(float))
    if squares == NULL:
        raise MemoryError
    cdef float *power = squares + size
    cdef float *between = power + size
    cdef const float *value = &c[0, 0]
    cdef const float *limit = &of_spectrum[0, 0, 0]
    cdef const float *inverse = &of_modes[1, 0, 0]
    cdef const float *firm = &of_modes[2, 0, 0]
    cdef float *W = &weight[0, 0]
    with nogil:
        memcpy(W, &of_spectrum[1, 0, 0], size * sizeof(float))
        for i in range(size):
            squares[i] = value[i] * value[i]
        failed = window_means(squares, K, L, power) < 0
        level = max(dot(size, squares, &of_modes[0, 0, 0]) / variance, 1)
        if not failed and any_above(size, power, variance, level, limit):
            a = excess(squares + L // 2, L - L // 2, 1, variance)
            b = excess(squares + K // 2 * L, K - K // 2, L, variance)
            for i in range(K):
                for j in range(L):
                    at = i * L + j
                    q = max(level, 1 + a * shared[i] + b * shared[K + j])
                    p = min(power[at], MOST)
                    if p > limit[at] * q:
                        own = max(p - 1, 0)
                        W[at] = own * inverse[at] / (own * firm[at] + 1)
        for i in range(size):
            squares[i] = W[i] * value[i]
        felt = dot(size, &total[0], squares)
        product(R, L, K, &left[0, 0], K, 1, squares, between)
        product(R, C, L, between, L, 1, &right[0, 0], &out[0, 0])
        seen = look_at(R * C, &out[0, 0])
        own = dot(size, W, W)
        free(squares)
    if failed:
        raise MemoryError
    return own, felt, seen.above, seen.above_squared, seen.below_squared, seen.highest


cdef float excess(const float *x, long n, long step, float variance) noexcept nogil:
    """How far the median of n squares is above that of noise of a `variance`, over it; 0 if it is not."""
    cdef long i, j, below, same
    for i in range(n):
        below = same = 0
        for j in range(n):
            below += x[j * step] < x[i * step]
            same += x[j * step] == x[i * step]
        if below <= n // 2 < below + same:
            return min(max(x[i * step] / (0.455 * variance) - 1, 0), MOST)  # 0.455: of a normal variable's square
    return NAN
