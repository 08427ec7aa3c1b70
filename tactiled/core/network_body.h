/* The loops of network.h for vectors of one width; see widths.h. */

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
