# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""The stages of a small network that redraws an image and holds it to a frame, float32."""

from libc.math cimport exp
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy, memset

cdef extern from "network.h" nogil:
    int redraw_image(int inputs, int filters, long rows, long columns, const float *images, const float *fixed,
                     const float *kernels, const float *scales, const float *offsets, const float *draw, float *out)

cdef extern from "products.h" nogil:
    void product(long m, long n, long l, const float *a, long down, long across, const float *b, float *out)


def tune(
    const float[::1] conditions,
    const float[::1] lowest,
    const float[::1] highest,
    const float[:, ::1] hidden,
    const float[:, ::1] last,
    float[::1] out,
):
    """Fit a network to its conditions (c,): out (n,) = [max([k, 1] hidden, 0), 1] last.

    k are the conditions, none outside `lowest` to `highest` (c,); `hidden` (c + 1, m), `last` (m + 1, n), whose last
    rows are constants. ValueError where shapes do not fit.
    """
    cdef long c = conditions.shape[0], m = hidden.shape[1], n = out.shape[0], i, j
    cdef float known, unit
    if not (lowest.shape[0] == highest.shape[0] == c == hidden.shape[0] - 1 and m == last.shape[0] - 1
            and n == last.shape[1]):
        raise ValueError("tune: shapes do not fit")
    with nogil:
        for j in range(n):
            out[j] = last[m, j]
        for i in range(m):
            unit = hidden[c, i]
            for j in range(c):
                known = min(max(conditions[j], lowest[j]), highest[j])
                unit += known * hidden[j, i]
            if unit <= 0:
                continue
            for j in range(n):
                out[j] += unit * last[i, j]


def redraw(
    const float[:, :, ::1] images,
    const float[:, :, ::1] fixed,
    const float[:, :, :, ::1] kernels,
    const float[::1] scales,
    const float[::1] offsets,
    const float[:, :, ::1] draw,
    float[:, ::1] out,
):
    """Draw one image (R, C) by F filters of I images (I, R, C), zero outside.

    filtered_f(p) = max(scales_f (sum_i,d kernels[i, d, f] images_i(p + d) + fixed_f(p)) + offsets_f, 0) and
    out(p) = sum_f,d draw[d, f] filtered_f(p + d), with the nine shifts d = (-1..1, -1..1) as (3, 3).

    `fixed` (F, R, C + 1) holds what does not change between frames; its last column is not used. `kernels`
    (I, 3, 3, F), `scales` and `offsets` (F,), `draw` (3, 3, F); F a multiple of 8. ValueError where shapes do not fit.
    """
    cdef long I = images.shape[0], R = images.shape[1], C = images.shape[2], F = kernels.shape[3]
    cdef int failed
    if not (
        I and F and F % 8 == 0 and R and C and R * (C + 1) >= 4
        and kernels.shape[0] == I and kernels.shape[1] == kernels.shape[2] == draw.shape[0] == draw.shape[1] == 3
        and scales.shape[0] == offsets.shape[0] == draw.shape[2] == fixed.shape[0] == F
        and fixed.shape[1] == out.shape[0] == R and fixed.shape[2] == C + 1 and out.shape[1] == C
    ):
        raise ValueError("redraw: shapes do not fit")
    with nogil:
        failed = redraw_image(
            I, F, R, C, &images[0, 0, 0], &fixed[0, 0, 0], &kernels[0, 0, 0, 0], &scales[0], &offsets[0],
            &draw[0, 0, 0], &out[0, 0],
        )
    if failed:
        raise MemoryError


cdef void held(
    long R, long C, long K, long L, const float *z, const float *down, const float *across, const float *back,
    const float *h, const float *c, float firmness, float *between, float *out,
) noexcept nogil:
    """Hold an image z (R, C) to a frame: out = z + V h (c - h V' z) / (h^2 + firmness).

    That is the least of |H x - y|^2 + firmness |x - z|^2 in the modes of a blur: V' z = down' z across, with
    `down` (R, K), `across` (C, L) and `back`, its transpose; h (K, L) their gains and c the frame's coefficients.
    `between` has room for what is in between.
    """
    cdef long i
    cdef float *left = between + max(R, K) * max(C, L)
    product(K, C, R, down, 1, K, z, between)
    product(K, L, C, between, C, 1, across, left)
    for i in range(K * L):
        left[i] = (c[i] - h[i] * left[i]) * h[i] / (h[i] * h[i] + firmness)
    product(R, L, K, down, K, 1, left, between)
    product(R, C, L, between, L, 1, back, out)
    for i in range(R * C):
        out[i] += z[i]


cdef int check(
    const float[:, ::1] image, const float[:, ::1] down, const float[:, ::1] across,
    const float[:, ::1] gain, const float[:, ::1] c,
) except -1:
    if not (
        gain.shape[0] and gain.shape[1] and image.shape[0] and image.shape[1]
        and down.shape[0] == image.shape[0] and across.shape[0] == image.shape[1]
        and gain.shape[0] == c.shape[0] == down.shape[1] and gain.shape[1] == c.shape[1] == across.shape[1]
    ):
        raise ValueError("shapes of image, bases, gain and coefficients do not fit")
    return 0


cdef void crop(const float *whole, long columns, long r, long c, long R, long C, float *part) noexcept nogil:
    """Copy the part (R, C) from row r, column c of rows of so many columns."""
    cdef long row
    for row in range(R):
        memcpy(part + row * C, whole + (r + row) * columns + c, C * sizeof(float))


def restore(
    const float[:, ::1] linear,
    float scale,
    const float[:, :, :, ::1] fixed,
    const float[:, :, :, :, ::1] kernels,
    const float[:, ::1] tuned,
    const float[:, :, :, ::1] draw,
    const float[:, ::1] down,
    const float[:, ::1] across,
    const float[:, ::1] gain,
    const float[:, ::1] c,
    float noise,
    (float, float) firm,
    (long, long, long, long) within,
    float[:, :, ::1] images,
    float[:, ::1] out,
):
    """Run S stages from a linear image (R, C) to `out` (R, C), which is not negative; both over `scale`, and so is c.

    Each redraws (`redraw`, by its part of `fixed`, `kernels` and `draw`, and of `tuned` (S, 2 F + 1): scales,
    offsets and firmness t) from three images: the image before it, held to the frame (`held`, by the firmness
    `noise` exp(firm[0] t + firm[1]) of the stage before), the same as it was, and the linear one. What it draws is
    added to the first, and held to the frame. The first stage begins with the linear image, cut off below zero where
    it is the first. `images` (3, R, C) get what the last one saw.
    All is done `within` (first row, end, first column, end), as if the surface ended there: the rest is zero.
    """
    cdef long S = kernels.shape[0], F = kernels.shape[4], rows = out.shape[0], columns = out.shape[1]
    cdef long K = gain.shape[0], L = gain.shape[1], s, i, row
    cdef long r = within[0], R = within[1] - within[0], q = within[2], C = within[3] - within[2]
    cdef int failed = 0
    cdef float firmness
    check(out, down, across, gain, c)
    if not (
        S and F and F % 8 == 0 and R * (C + 1) >= 4 and images.shape[0] == kernels.shape[1] == 3
        and images.shape[1] == linear.shape[0] == rows and images.shape[2] == linear.shape[1] == columns
        and 0 <= r and R > 0 and r + R <= rows and 0 <= q and C > 0 and q + C <= columns
        and fixed.shape[0] == tuned.shape[0] == draw.shape[0] == S
        and fixed.shape[1] == draw.shape[3] == F and fixed.shape[2] == rows and fixed.shape[3] == columns + 1
        and kernels.shape[2] == kernels.shape[3] == draw.shape[1] == draw.shape[2] == 3
        and tuned.shape[1] == 2 * F + 1
    ):
        raise ValueError("restore: shapes do not fit")
    cdef float *first = <float *>malloc(
        (4 * R * C + K * L + F * R * (C + 1) + L * C + max(R, K) * max(C, L) + K * L) * sizeof(float)
    )
    if first == NULL:
        raise MemoryError
    cdef float *before = first + R * C
    cdef float *start = before + R * C
    cdef float *z = start + R * C
    cdef float *scaled = z + R * C
    cdef float *there = scaled + K * L
    cdef float *back = there + F * R * (C + 1)
    cdef float *between = back + L * C
    with nogil:
        for i in range(rows * columns):
            (&images[2, 0, 0])[i] = (&linear[0, 0])[i] / scale
        for i in range(K * L):
            scaled[i] = (&c[0, 0])[i] / scale
        crop(&images[2, 0, 0], columns, r, q, R, C, start)
        for i in range(C * L):
            back[i % L * C + i / L] = across[q + i / L, i % L]
        for i in range(R * C):
            first[i], before[i] = max(start[i], 0), start[i]
        memset(&out[0, 0], 0, rows * columns * sizeof(float))
        memset(&images[0, 0, 0], 0, 2 * rows * columns * sizeof(float))
        for s in range(S):
            if s:
                memcpy(before, z, R * C * sizeof(float))
            for i in range(F):
                crop(&fixed[s, i, 0, 0], columns + 1, r, q, R, C + 1, there + i * R * (C + 1))
            failed = failed or redraw_image(
                3, F, R, C, first, there, &kernels[s, 0, 0, 0, 0], &tuned[s, 0], &tuned[s, F], &draw[s, 0, 0, 0], z
            )
            for i in range(R * C):
                z[i] += first[i]
            if s == S - 1:
                for row in range(R):
                    memcpy(&images[0, r + row, q], first + row * C, C * sizeof(float))
                    memcpy(&images[1, r + row, q], before + row * C, C * sizeof(float))
            firmness = noise * exp(firm[0] * tuned[s, 2 * F] + firm[1])
            held(R, C, K, L, z, &down[r, 0], &across[q, 0], back, &gain[0, 0], scaled, firmness, between, first)
        for row in range(R):
            for i in range(C):
                out[r + row, q + i] = 0 if first[row * C + i] < 0 else scale * first[row * C + i]  # NaN stays
        free(first)
    if failed:
        raise MemoryError
