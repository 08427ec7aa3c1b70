# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Counts of taxels to pressure, and looks at a frame, float32."""

from libc.math cimport INFINITY, M_PI, M_SQRT2, NAN, erfc, exp, fabs, sqrt

cdef extern from "looks.h" nogil:
    struct looks:
        float lowest, highest
        long known

    looks look_at(long n, const float *x)


def calibrate(
    const float[:, ::1] counts,
    const unsigned char[:, ::1] flags,
    const unsigned char[::1] states,
    const float[::1] zero,
    const float[::1] gain,
    const float[::1] added,
    float saturation,
    unsigned char unknown,
    unsigned char saturated,
    float[:, ::1] pressure,
    unsigned char[:, ::1] out,
):
    """Fill `pressure` (T, N) with (counts - zero + added) gain, and `out` with flags | states, of T frames.

    Taxels with any flag of `unknown` have NaN. The others get the flag `saturated` where their counts are at
    `saturation` (NaN: none) or beyond, which is below where the gain is negative. `states`, `zero`, `gain` and
    `added`: (N,). ValueError where shapes do not fit.
    """
    cdef long T = counts.shape[0], N = counts.shape[1], t, i
    cdef unsigned char seen
    cdef bint full
    if not (
        flags.shape[0] == pressure.shape[0] == out.shape[0] == T and flags.shape[1] == pressure.shape[1] == N
        and out.shape[1] == states.shape[0] == zero.shape[0] == gain.shape[0] == added.shape[0] == N
    ):
        raise ValueError("calibrate: shapes do not fit")
    with nogil:
        for t in range(T):
            seen = 0
            for i in range(N):
                out[t, i] = flags[t, i] | states[i]
                seen |= out[t, i]
            for i in range(N):
                pressure[t, i] = (counts[t, i] - zero[i] + added[i]) * gain[i]
            if seen & unknown:
                for i in range(N):
                    if out[t, i] & unknown:
                        pressure[t, i] = NAN
            if saturation == saturation:
                for i in range(N):
                    full = counts[t, i] <= saturation if gain[i] < 0 else counts[t, i] >= saturation
                    if full and not out[t, i] & unknown:
                        out[t, i] |= saturated


def look(const float[::1] x):
    """Give the lowest and the highest of the values that are no NaN, and how many they are; none: inf, -inf, 0."""
    cdef looks seen
    if x.shape[0] == 0:
        return INFINITY, -INFINITY, 0
    with nogil:
        seen = look_at(x.shape[0], &x[0])
    return seen.lowest, seen.highest, seen.known


def keep_total(
    float[::1] x,
    const float[::1] weight,
    float total,
    float likely,
    float most_noise,
    float agrees,
    float clear,
    float least,
    float most,
    int passes,
):
    """Hold values x (M,), none below 0, to a `total` of sum(weight x) but for its noise, in place.

    That is the `likely` part of the difference, or none of one that is not below `most_noise`.
    An excess is taken from all values above 0 alike, by as many passes of Newton's method as it needs, `passes` at
    most; what it lacks, or has too much then, is scaled by `least` to `most`. Nothing is done for a difference
    within `agrees`, or where the total is within `clear` of 0. ValueError where shapes do not fit.
    """
    cdef long M = x.shape[0], i
    cdef int done
    cdef float felt, pressed, missed, noise = 0, scale = 1
    if weight.shape[0] != M:
        raise ValueError("keep_total: shapes do not fit")
    with nogil:
        for done in range(passes):
            felt = pressed = 0
            for i in range(M):
                felt += weight[i] * x[i]
                pressed += weight[i] if x[i] > 0 else 0
            if not done and fabs(total - felt) < most_noise:
                noise = likely * (total - felt)
            missed, scale = total - noise - felt, 1
            if not (-agrees < missed < agrees or -clear < total < clear or (felt + noise) * total <= 0):
                scale = min(max(total / (felt + noise), least), most)
            if scale >= 1:
                break
            missed /= pressed
            for i in range(M):
                x[i] = max(x[i] + missed, 0) if x[i] > 0 else x[i]
        if scale != 1:
            for i in range(M):
                x[i] *= scale


def compare(
    const float[::1] read, const float[::1] felt, const unsigned char[::1] flags, float noise, float error, float far
):
    """Compare what taxels (N,) read with what they would feel of an image, where their flags are 0.

    The expected difference is e = hypot(noise, `error` times the largest reading, of either sign).
    Gives how many those are, their lowest and highest and how many have that, the sum of the squares below 0; e, how
    many differ by over `far` e, and the mean of the squares of all differences over e; then of all taxels the sum of
    squares of what is felt, and that of its products with what is read, or felt where that is not to be used.
    ValueError where shapes do not fit.
    """
    cdef long N = read.shape[0], i, known = 0, same = 0, outliers = 0
    cdef float lowest = INFINITY, highest = -INFINITY, below = 0, squares = 0, strength = 0, product = 0, expected, off
    if not felt.shape[0] == flags.shape[0] == N:
        raise ValueError("compare: shapes do not fit")
    with nogil:
        for i in range(N):
            strength += felt[i] * felt[i]
            if flags[i]:
                product += felt[i] * felt[i]
                continue
            known += 1
            product += felt[i] * read[i]
            below += read[i] * read[i] if read[i] < 0 else 0
            lowest = min(lowest, read[i])
            highest = max(highest, read[i])
        expected = error * max(highest, -lowest)
        expected = sqrt(noise * noise + expected * expected)
        for i in range(N):
            if flags[i]:
                continue
            off = fabs(felt[i] - read[i]) / expected
            squares += off * off
            outliers += off > far
            same += read[i] == highest
    return known, lowest, highest, same, below, expected, outliers, squares / max(known, 1), strength, product


def part_sums(const float[:, ::1] x, const long[::1] rows, const long[::1] columns, double[:, ::1] out):
    """Fill `out` (P, Q) with the sums over parts of x (R, C), which begin at `rows` (P,) and `columns` (Q,)."""
    cdef long R = x.shape[0], C = x.shape[1], P = rows.shape[0], Q = columns.shape[0], i, j, p = 0, q
    cdef float total
    if not (P and Q and out.shape[0] == P and out.shape[1] == Q and rows[0] == columns[0] == 0
            and rows[P - 1] < R and columns[Q - 1] < C):
        raise ValueError("part_sums: shapes do not fit")
    with nogil:
        out[:, :] = 0
        for i in range(R):
            if p + 1 < P and rows[p + 1] <= i:
                p += 1
            for q in range(Q):
                total = 0
                for j in range(columns[q], columns[q + 1] if q + 1 < Q else C):
                    total += x[i, j]
                out[p, q] += total


def raise_above(
    const double[:, ::1] precision,
    const double[::1] right,
    const double[::1] bounds,
    double sigma,
    int sweeps,
    double[::1] x,
):
    """Move x (m,) towards the means of normal values that are not below their `bounds` (m,), -inf for none.

    The values have the covariance `precision`^-1 sigma^2 (m, m), and without bounds the mean precision^-1 `right`.
    Each is taken to be independent but for the means of the others (mean field), in so many `sweeps`:
    x_i = v + s phi(a) / (1 - Phi(a)) with v = (right_i - sum_{j != i} precision_ij x_j) / precision_ii,
    s = sigma / sqrt(precision_ii) and a = (bound_i - v) / s. ValueError where shapes do not fit.
    """
    cdef long m = x.shape[0], i, j
    cdef int sweep
    cdef double v, s, a
    if not precision.shape[0] == precision.shape[1] == right.shape[0] == bounds.shape[0] == m:
        raise ValueError("raise_above: shapes do not fit")
    with nogil:
        for sweep in range(sweeps):
            for i in range(m):
                v = right[i] + precision[i, i] * x[i]
                for j in range(m):
                    v -= precision[i, j] * x[j]
                v /= precision[i, i]
                s = sigma / sqrt(precision[i, i])
                a = (bounds[i] - v) / s
                # Far above, the ratio of two numbers that underflow is a + 1 / a but for its third power.
                x[i] = v + s * (a + 1 / a if a > 25 else sqrt(2 / M_PI) * exp(-a * a / 2) / erfc(a / M_SQRT2))
