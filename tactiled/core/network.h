/* The inner loops of tactiled.core.network, which has their formulas. */

#include <stdlib.h>
#include <string.h>

#define BLOCK 8  /* filters, or rows, whose sums stay in registers */
#define SHIFTS 9 /* of a kernel of 3 x 3 */

/* Rows of an image each followed by a zero, so that every shift is a shift in memory; zeros around all of them. */
struct raster {
  long cells, line, margin, padded;
};

#define BODY "network_body.h"
#include "widths.h"
#undef BODY

static int redraw_image(int inputs, int filters, long rows, long columns, const float *images, const float *fixed,
                        const float *kernels, const float *scales, const float *offsets, const float *draw,
                        float *out) {
  const long line = columns + 1;
  const struct raster at = {rows * line, line, line + 1, rows * line + 2 * (line + 1)};
  float *padded = calloc((inputs + SHIFTS) * at.padded, sizeof(float));
  if (!padded) return -1;
  float *maps = padded + inputs * at.padded;
  for (long i = 0; i < inputs; i++)
    for (long row = 0; row < rows; row++)
      memcpy(padded + i * at.padded + at.margin + row * line, images + (i * rows + row) * columns, 4 * columns);
  const int width = vector_width(at.cells / 2);
  AT_WIDTH(width, maps, at, inputs, filters, padded, fixed, kernels, scales, offsets, draw, maps);
  for (long k = 0; k < SHIFTS; k++)
    for (long row = 0; row < rows; row++) maps[k * at.padded + at.margin + row * line + columns] = 0;
  for (long row = 0; row < rows; row++)
    for (long column = 0; column < columns; column++) {
      float sum = 0;
      for (long k = 0; k < SHIFTS; k++) sum += maps[k * at.padded + (row + k / 3) * line + column + k % 3];
      out[row * columns + column] = sum;
    }
  free(padded);
  return 0;
}
