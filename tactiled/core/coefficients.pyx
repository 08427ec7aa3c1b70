# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Images and frames in the modes of a blur, float32: their coefficients, and what those tell of a scene."""

from libc.math cimport INFINITY, NAN
from libc.stdlib cimport free, malloc

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


def outstanding(
    const float[:, ::1] squares,
    float variance,
    const float[:, ::1] limit,
    const float[:, ::1] quiet,
    const float[::1] down,
    const float[::1] across,
    const float[:, ::1] inverse,
    const float[:, ::1] firm,
    const float[:, ::1] weight,
    float[:, ::1] out,
):
    """Whether modes (K, L) stand out of a spectrum; fills `out` with the weight W of each mode, else `weight`.

    `squares`: of a frame's coefficients; all powers are over the noise's `variance`. Their mean in a window of 5 x 5
    modes is p; a mode stands out where p > `limit` times q, the most of 1, the squares' mean by the weights `quiet`,
    and what rows and columns share, 1 + a `down` (K,) + b `across` (L,). a and b: by how much the squares' median in
    the upper half of the first row, or column, is above noise's. Then W = s `inverse` / (s `firm` + 1) with
    s = max(p - 1, 0).
    ValueError where shapes do not fit.
    """
    cdef long K = squares.shape[0], L = squares.shape[1], size = K * L, i, j
    cdef bint found = False, failed = False
    cdef float level, a, b, q, p, own
    if not (
        K and L and limit.shape[0] == quiet.shape[0] == inverse.shape[0] == firm.shape[0] == weight.shape[0] == K
        and out.shape[0] == down.shape[0] == K and out.shape[1] == across.shape[0] == L
        and limit.shape[1] == quiet.shape[1] == inverse.shape[1] == firm.shape[1] == weight.shape[1] == L
    ):
        raise ValueError("outstanding: shapes do not fit")
    cdef float *power = <float *>malloc(size * sizeof(float))
    if power == NULL:
        raise MemoryError
    cdef const float *c = &squares[0, 0]
    cdef const float *most = &limit[0, 0]
    cdef const float *calm = &quiet[0, 0]
    with nogil:
        failed = window_means(c, K, L, power) < 0
        level = max(dot(size, c, calm) / variance, 1)
        if not failed and any_above(size, power, variance, level, most):
            a = excess(c + L // 2, L - L // 2, 1, variance)
            b = excess(c + K // 2 * L, K - K // 2, L, variance)
            for i in range(K):
                for j in range(L):
                    q = max(level, 1 + a * down[i] + b * across[j])
                    p = min(power[i * L + j], MOST)
                    if p > limit[i, j] * q:
                        own = max(p - 1, 0)
                        out[i, j] = own * inverse[i, j] / (own * firm[i, j] + 1)
                        found = True
                    else:
                        out[i, j] = weight[i, j]
        free(power)
    if failed:
        raise MemoryError
    return found


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


def signed_sums(const float[:, ::1] x):
    """Give the sum and the sum of squares of what is above 0, the sum of squares of what is below, and the highest.

    NaN where there is no value.
    """
    cdef looks seen
    if x.shape[0] * x.shape[1] == 0:
        return 0.0, 0.0, 0.0, NAN
    with nogil:
        seen = look_at(x.shape[0] * x.shape[1], &x[0, 0])
    return seen.above, seen.above_squared, seen.below_squared, seen.highest
