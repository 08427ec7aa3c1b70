/* The loops of network.h for vectors of one width; see widths.h. */

/* Every filter at PAIR WIDTH cells at a time, cut off below zero, and what it adds to each of the nine maps: a weight
   is loaded once for PAIR vectors. */
#define PAIR (WIDTH / 16 + 1) /* as many as registers hold */
#define STEP (PAIR * WIDTH)
TARGET static void NAME(maps)(struct raster at, int inputs, int filters, const float *padded, const float *fixed,
                              const float *kernels, const float *scales, const float *offsets, const float *draw,
                              float *maps) {
  for (long p = 0; p < at.cells; p += STEP) {
    if (p + STEP > at.cells) p = at.cells - STEP;
    NAME(vec) sums[SHIFTS][PAIR] = {0};
    for (int first = 0; first < filters; first += BLOCK) {
      NAME(vec) filtered[BLOCK][PAIR];
      for (int j = 0; j < BLOCK; j++)
        for (int v = 0; v < PAIR; v++)
          filtered[j][v] = *(const NAME(loose) *)(fixed + (first + j) * at.cells + p + v * WIDTH);
      for (int i = 0; i < inputs; i++)
        for (int k = 0; k < SHIFTS; k++) {
          const float *x = padded + i * at.padded + p + k / 3 * at.line + k % 3;
          const float *kernel = kernels + (i * SHIFTS + k) * filters + first;
          NAME(vec) cells[PAIR];
          for (int v = 0; v < PAIR; v++) cells[v] = *(const NAME(loose) *)(x + v * WIDTH);
          for (int j = 0; j < BLOCK; j++)
            for (int v = 0; v < PAIR; v++) filtered[j][v] += kernel[j] * cells[v];
        }
      for (int j = 0; j < BLOCK; j++)
        for (int v = 0; v < PAIR; v++) {
          const NAME(vec) x = scales[first + j] * filtered[j][v] + offsets[first + j];
          filtered[j][v] = (NAME(vec))((NAME(bits))x & ~(x <= 0)); /* NaN stays */
        }
      for (int k = 0; k < SHIFTS; k++)
        for (int j = 0; j < BLOCK; j++)
          for (int v = 0; v < PAIR; v++) sums[k][v] += draw[k * filters + first + j] * filtered[j][v];
    }
    for (int k = 0; k < SHIFTS; k++)
      for (int v = 0; v < PAIR; v++)
        *(NAME(loose) *)(maps + k * at.padded + at.margin + p + v * WIDTH) = sums[k][v];
  }
}
#undef STEP
#undef PAIR
