# cython: language_level=3, boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""Which cells of a picture (R, C) belong to which contact, float64."""

from libc.stdint cimport int64_t
from libc.stdlib cimport free, malloc


cdef inline int64_t find(int64_t* joined, int64_t number) noexcept nogil:
    while joined[number] != number:
        joined[number] = joined[joined[number]]
        number = joined[number]
    return number


def split(
    const double[:, ::1] picture,
    const int64_t[::1] order,
    const double[:, ::1] high_near,
    const double[:, ::1] least,
    const int64_t[:, ::1] was,
    (double, double, double) shares,
    double skirt,
    int64_t[:, ::1] parts,
):
    """Number the cells of a picture by contact in `parts` (all 0 before; 0 stays where nothing presses).

    `order` are the cells that are pressed, the highest first. Each belongs to the basin of the highest of its eight
    neighbours, or begins one. Two basins that meet stay apart if the dip is deep below the lower peak: by `least`,
    and by a share of `high_near`, the highest that counts near that peak. They stay apart, too, if the dip is below
    `skirt` of `high_near`, and the peak is above that. The three `shares` hold for peaks that were in one contact in
    the image before, `was`; for those that were in two; and for all others.
    """
    cdef int64_t rows = picture.shape[0], columns = picture.shape[1], n, cell, row, column, r, c, count = 0
    cdef int64_t number, other, low, high, top
    cdef double value, best, dip, near
    cdef int64_t* joined = NULL  # of each basin a number of the one it is part of
    cdef int64_t* tops = NULL  # and the cell of its peak
    if not (
        rows == high_near.shape[0] == least.shape[0] == was.shape[0] == parts.shape[0]
        and columns == high_near.shape[1] == least.shape[1] == was.shape[1] == parts.shape[1]
    ):
        raise ValueError("split: shapes do not fit")
    joined = <int64_t*>malloc((order.shape[0] + 1) * sizeof(int64_t))
    tops = <int64_t*>malloc((order.shape[0] + 1) * sizeof(int64_t))
    if joined == NULL or tops == NULL:
        free(joined)
        free(tops)
        raise MemoryError
    with nogil:
        for n in range(order.shape[0]):
            cell = order[n]
            row, column = cell // columns, cell % columns
            value, best, number = picture[row, column], 0, 0
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if parts[r, c] and (not number or picture[r, c] > best):
                        number, best = parts[r, c], picture[r, c]
            if not number:
                count += 1
                number = joined[count] = count
                tops[count] = cell
            parts[row, column] = number
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if not parts[r, c]:
                        continue
                    low, high = find(joined, number), find(joined, parts[r, c])
                    if low == high:
                        continue
                    if height(picture, tops[low]) > height(picture, tops[high]):
                        low, high = high, low
                    top, other = tops[low], tops[high]
                    near, dip = height(high_near, top), height(picture, top) - value
                    if value < skirt * near < height(picture, top):
                        continue
                    near *= share(was[top // columns, top % columns], was[other // columns, other % columns], shares)
                    if dip < max(height(least, top), near):
                        joined[low] = high
        for n in range(order.shape[0]):
            row, column = order[n] // columns, order[n] % columns
            parts[row, column] = find(joined, parts[row, column])
    free(joined)
    free(tops)


cdef inline double height(const double[:, ::1] picture, int64_t cell) noexcept nogil:
    return picture[cell // picture.shape[1], cell % picture.shape[1]]


cdef inline double share(int64_t one, int64_t other, (double, double, double) shares) noexcept nogil:
    if not one or not other:
        return shares[2]
    return shares[0] if one == other else shares[1]


def widen(const int64_t[:, ::1] parts, const double[:, ::1] picture, int64_t[:, ::1] skirts):
    """Give the contacts of `parts` one more cell on each of four sides: `skirts`; in doubt to the higher neighbour."""
    cdef int64_t rows = parts.shape[0], columns = parts.shape[1], row, column, r, c
    cdef double best
    if not (rows == picture.shape[0] == skirts.shape[0] and columns == picture.shape[1] == skirts.shape[1]):
        raise ValueError("widen: shapes do not fit")
    with nogil:
        for row in range(rows):
            for column in range(columns):
                skirts[row, column] = parts[row, column]
                if parts[row, column]:
                    continue
                for r in range(max(row - 1, 0), min(row + 2, rows)):
                    for c in range(max(column - 1, 0), min(column + 2, columns)):
                        if (r == row) != (c == column) and parts[r, c]:
                            if not skirts[row, column] or picture[r, c] > best:
                                skirts[row, column], best = parts[r, c], picture[r, c]
