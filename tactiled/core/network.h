/* The inner loops of tactiled.core.network, which has their formulas. */

#include <stdlib.h>
#include <string.h>

#define BLOCK 8  /* filters, or rows, whose sums stay in registers */
#define SHIFTS 9 /* of a kernel of 3 x 3 */

/* Rows of an image each followed by a zero, so that every shift is a shift in memory; zeros around all of them. */
struct raster {
  long cells, line, margin, padded;
};

/* What follows the kernels of some filters. */
struct block {
  float scale[BLOCK], offset[BLOCK], draw[BLOCK][SHIFTS];
};

#define BODY "network_body.h"
#include "widths.h"
#undef BODY

static int redraw_image(int inputs, int filters, long rows, long columns, const float *images, const float *fixed,
                        const float *kernels, const float *scales, const float *offsets, const float *draw,
                        float *out) {
  const long line = columns + 1, taps = SHIFTS * inputs, count = (filters + BLOCK - 1) / BLOCK;
  const struct raster at = {rows * line, line, line + 1, rows * line + 2 * (line + 1)};
  float *memory = calloc(inputs * at.padded + SHIFTS * at.padded + count * (BLOCK * taps + sizeof(struct block) / 4), 4);
  if (!memory) return -1;
  float *padded = memory, *maps = padded + inputs * at.padded, *ordered = maps + SHIFTS * at.padded;
  struct block *blocks = (struct block *)(ordered + count * BLOCK * taps);
  for (long i = 0; i < inputs; i++)
    for (long row = 0; row < rows; row++)
      memcpy(padded + i * at.padded + at.margin + row * line, images + (i * rows + row) * columns, 4 * columns);
  for (long f = 0; f < filters; f++) {
    struct block *block = blocks + f / BLOCK;
    for (long k = 0; k < taps; k++) ordered[(f / BLOCK * taps + k) * BLOCK + f % BLOCK] = kernels[f * taps + k];
    block->scale[f % BLOCK] = scales[f], block->offset[f % BLOCK] = offsets[f];
    for (long k = 0; k < SHIFTS; k++) block->draw[f % BLOCK][k] = draw[k * filters + f];
  }
  const int width = vector_width(at.cells / 2);
  AT_WIDTH(width, maps, at, inputs, filters, padded, fixed, blocks, ordered, maps);
  for (long k = 0; k < SHIFTS; k++)
    for (long row = 0; row < rows; row++) maps[k * at.padded + at.margin + row * line + columns] = 0;
  for (long row = 0; row < rows; row++)
    for (long column = 0; column < columns; column++) {
      float sum = 0;
      for (long k = 0; k < SHIFTS; k++) sum += maps[k * at.padded + (row + k / 3) * line + column + k % 3];
      out[row * columns + column] = sum;
    }
  free(memory);
  return 0;
}
