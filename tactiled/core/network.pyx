# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""The stages of a small network that redraws an image and holds it to a frame, float32."""

from libc.stdlib cimport free, malloc

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

    filtered_f(p) = max(scales_f (sum_i,d kernels[f, i, d] images_i(p + d) + fixed_f(p)) + offsets_f, 0) and
    out(p) = sum_f,d draw[d, f] filtered_f(p + d), with the nine shifts d = (-1..1, -1..1) as (3, 3).

    `fixed` (F, R, C + 1) holds what does not change between frames; its last column is not used. `kernels`
    (F, I, 3, 3), `scales` and `offsets` (F,), `draw` (3, 3, F). ValueError where shapes do not fit.
    """
    cdef long I = images.shape[0], R = images.shape[1], C = images.shape[2], F = kernels.shape[0]
    cdef int failed
    if not (
        I and F and R and C and R * (C + 1) >= 4
        and kernels.shape[1] == I and kernels.shape[2] == kernels.shape[3] == draw.shape[0] == draw.shape[1] == 3
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


cdef void missed(
    const float[:, ::1] image, const float[:, ::1] down, const float[:, ::1] across,
    const float[:, ::1] gain, const float[:, ::1] c, float *between, float *left,
) noexcept nogil:
    """Fill `left` (K, L): c - h (down' image across)."""
    cdef long R = image.shape[0], C = image.shape[1], K = down.shape[1], L = across.shape[1], i
    cdef const float *h = &gain[0, 0]
    cdef const float *y = &c[0, 0]
    product(K, C, R, &down[0, 0], 1, K, &image[0, 0], between)
    product(K, L, C, between, C, 1, &across[0, 0], left)
    for i in range(K * L):
        left[i] = y[i] - h[i] * left[i]


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


def hold(
    const float[:, ::1] image,
    const float[:, ::1] down,
    const float[:, ::1] across,
    const float[:, ::1] back,
    const float[:, ::1] gain,
    const float[:, ::1] c,
    float firmness,
    float[:, ::1] out,
):
    """Hold an image z (R, C) to a frame: out = z + V h (c - h V' z) / (h^2 + firmness).

    That is the least of |H x - y|^2 + firmness |x - z|^2 in the modes of a blur: V' z = down' z across, with
    `down` (R, K), `across` (C, L) and `back`, its transpose; h the modes' `gain` and `c` the frame's coefficients,
    both (K, L). ValueError where shapes do not fit.
    """
    cdef long R = image.shape[0], C = image.shape[1], K = gain.shape[0], L = gain.shape[1], i
    check(image, down, across, gain, c)
    if back.shape[0] != L or back.shape[1] != C or out.shape[0] != R or out.shape[1] != C:
        raise ValueError("hold: shapes of out and back do not fit")
    cdef float *between = <float *>malloc((max(R, K) * max(C, L) + K * L) * sizeof(float))
    if between == NULL:
        raise MemoryError
    cdef float *left = between + max(R, K) * max(C, L)
    cdef const float *h = &gain[0, 0]
    with nogil:
        missed(image, down, across, gain, c, between, left)
        for i in range(K * L):
            left[i] = left[i] * h[i] / (h[i] * h[i] + firmness)
        product(R, L, K, &down[0, 0], K, 1, left, between)
        product(R, C, L, between, L, 1, &back[0, 0], &out[0, 0])
        for i in range(R * C):
            (&out[0, 0])[i] += (&image[0, 0])[i]
        free(between)


def misfit(
    const float[:, ::1] image,
    const float[:, ::1] down,
    const float[:, ::1] across,
    const float[:, ::1] gain,
    const float[:, ::1] c,
    float image_error,
    float noise,
):
    """Mean square of what an image leaves of a frame's modes, c - h V' z, over what it may: (h e)^2 + noise^2.

    e is `image_error` times the image's root mean square; the rest is as in `hold`.
    """
    cdef long K = gain.shape[0], L = gain.shape[1], i
    cdef long cells = image.shape[0] * image.shape[1]
    cdef double total = 0
    cdef float squares = 0
    check(image, down, across, gain, c)
    cdef float *between = <float *>malloc((K * image.shape[1] + K * L) * sizeof(float))
    if between == NULL:
        raise MemoryError
    cdef float *left = between + K * image.shape[1]
    cdef const float *h = &gain[0, 0]
    cdef const float *z = &image[0, 0]
    with nogil:
        for i in range(cells):
            squares += z[i] * z[i]
        squares *= image_error * image_error / cells
        missed(image, down, across, gain, c, between, left)
        for i in range(K * L):
            total += left[i] * left[i] / (h[i] * h[i] * squares + noise * noise)
        free(between)
    return total / (K * L)
