/* The loops of network.h for vectors of one width; see widths.h. */

typedef float NAME(vec) __attribute__((vector_size(4 * WIDTH)));
typedef float NAME(loose) __attribute__((vector_size(4 * WIDTH), aligned(4), may_alias));
typedef int NAME(bits) __attribute__((vector_size(4 * WIDTH)));

/* Every filter at WIDTH cells at a time, cut off below zero, and what it adds to each of the nine maps. */
TARGET static void NAME(maps)(struct raster at, int inputs, int filters, const float *padded, const float *fixed,
                              const struct block *blocks, const float *kernels, float *maps) {
  for (long p = 0; p < at.cells; p += WIDTH) {
    if (p + WIDTH > at.cells) p = at.cells - WIDTH;
    NAME(vec) sums[SHIFTS] = {0};
    const float *kernel = kernels;
    for (int first = 0; first < filters; first += BLOCK) {
      const struct block *block = blocks + first / BLOCK;
      NAME(vec) filtered[BLOCK];
      for (int j = 0; j < BLOCK; j++) {
        const int filter = first + j < filters ? first + j : first;
        filtered[j] = *(const NAME(loose) *)(fixed + filter * at.cells + p);
      }
      for (int i = 0; i < inputs; i++)
        for (int dy = 0; dy < 3; dy++)
          for (int dx = 0; dx < 3; dx++, kernel += BLOCK) {
            const NAME(vec) x = *(const NAME(loose) *)(padded + i * at.padded + p + dy * at.line + dx);
            for (int j = 0; j < BLOCK; j++) filtered[j] += kernel[j] * x;
          }
      for (int j = 0; j < BLOCK; j++) {
        NAME(vec) x = block->scale[j] * filtered[j] + block->offset[j];
        x = (NAME(vec))((NAME(bits))x & ~(x <= 0)); /* NaN stays */
        for (int k = 0; k < SHIFTS; k++) sums[k] += block->draw[j][k] * x;
      }
    }
    for (int k = 0; k < SHIFTS; k++) *(NAME(loose) *)(maps + k * at.padded + at.margin + p) = sums[k];
  }
}

/* out (m, n) = A B, with A[i, k] at a[i down + k across] and B (l, n): BLOCK rows and WIDTH columns at a time. */
TARGET static void NAME(product)(long m, long n, long l, const float *a, long down, long across, const float *b,
                                 float *out) {
  for (long column = 0; column < n; column += WIDTH) {
    if (column + WIDTH > n) column = n - WIDTH;
    for (long row = 0; row < m; row += BLOCK) {
      const float *rows[BLOCK];
      NAME(vec) sums[BLOCK] = {0};
      for (int j = 0; j < BLOCK; j++) rows[j] = a + (row + j < m ? row + j : m - 1) * down;
      for (long k = 0; k < l; k++) {
        const NAME(vec) x = *(const NAME(loose) *)(b + k * n + column);
        for (int j = 0; j < BLOCK; j++) sums[j] += rows[j][k * across] * x;
      }
      for (int j = 0; j < BLOCK && row + j < m; j++) *(NAME(loose) *)(out + (row + j) * n + column) = sums[j];
    }
  }
}
