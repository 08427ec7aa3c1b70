/* The loops of network.h for vectors of one width; see widths.h. */

/* Every filter at PAIR WIDTH cells at a time, cut off below zero, and what it adds to each of the nine maps: a weight
   is loaded once for PAIR vectors. */
#define PAIR (WIDTH / 16 + 1) /* as many as registers hold */
#define STEP (PAIR * WIDTH)
TARGET static void NAME(maps)(struct raster at, int inputs, int filters, const float *padded, const float *fixed,
                              const struct block *blocks, const float *kernels, float *maps) {
  for (long p = 0; p < at.cells; p += STEP) {
    if (p + STEP > at.cells) p = at.cells - STEP;
    NAME(vec) sums[SHIFTS][PAIR] = {0};
    const float *kernel = kernels;
    for (int first = 0; first < filters; first += BLOCK) {
      const struct block *block = blocks + first / BLOCK;
      NAME(vec) filtered[BLOCK][PAIR];
      for (int j = 0; j < BLOCK; j++)
        for (int v = 0; v < PAIR; v++) {
          const int filter = first + j < filters ? first + j : first;
          filtered[j][v] = *(const NAME(loose) *)(fixed + filter * at.cells + p + v * WIDTH);
        }
      for (int i = 0; i < inputs; i++)
        for (int dy = 0; dy < 3; dy++)
          for (int dx = 0; dx < 3; dx++, kernel += BLOCK) {
            const float *x = padded + i * at.padded + p + dy * at.line + dx;
            NAME(vec) cells[PAIR];
            for (int v = 0; v < PAIR; v++) cells[v] = *(const NAME(loose) *)(x + v * WIDTH);
            for (int j = 0; j < BLOCK; j++)
              for (int v = 0; v < PAIR; v++) filtered[j][v] += kernel[j] * cells[v];
          }
      for (int j = 0; j < BLOCK; j++)
        for (int v = 0; v < PAIR; v++) {
          NAME(vec) x = block->scale[j] * filtered[j][v] + block->offset[j];
          x = (NAME(vec))((NAME(bits))x & ~(x <= 0)); /* NaN stays */
          for (int k = 0; k < SHIFTS; k++) sums[k][v] += block->draw[j][k] * x;
        }
    }
    for (int k = 0; k < SHIFTS; k++)
      for (int v = 0; v < PAIR; v++)
        *(NAME(loose) *)(maps + k * at.padded + at.margin + p + v * WIDTH) = sums[k][v];
  }
}
#undef STEP
#undef PAIR
