/* Sums, ranges and means of values that follow one another in memory, float32, for the looks at an image or a frame. */

#ifndef CORE_LOOKS
#define CORE_LOOKS

#include <math.h>
#include <stdlib.h>

#define REACH 2 /* values on either side whose mean is taken with one */
#define SELECT(which, a, b) ((NAME(vec))(((which) & (NAME(bits))(a)) | (~(which) & (NAME(bits))(b))))

/* Of the values that are not NaN the lowest, the highest and how many they are. The sum of those above 0, of their
   squares, and of the squares of those below; NaN where any value is. */
struct looks {
  float lowest, highest, above, above_squared, below_squared;
  long known;
};

#define BODY "looks_body.h"
#include "widths.h"
#undef BODY

static struct looks look_at(long n, const float *x) {
  struct looks out = {INFINITY, -INFINITY, 0, 0, 0, 0};
  const int width = vector_width(n);
  AT_WIDTH(width, look_at, n, x, &out);
  return out;
}

static float dot(long n, const float *a, const float *b) {
  const int width = vector_width(n);
  return AT_WIDTH(width, dot, n, a, b);
}

/* Means over REACH values on either side along both axes, fewer at the border; -1 where there is no memory. */
static int window_means(const float *x, long rows, long columns, float *out) {
  float *share = calloc(rows + columns + columns + 2 * REACH, sizeof(float));
  if (!share) return -1;
  for (long i = 0; i < rows + columns; i++) {
    const long n = i < rows ? rows : columns, at = i < rows ? i : i - rows;
    share[i] = 1.0f / (1 + (at < REACH ? at : REACH) + (n - 1 - at < REACH ? n - 1 - at : REACH));
  }
  const int width = vector_width(columns);
  AT_WIDTH(width, window_means, x, rows, columns, share, share + rows, share + rows + columns, out);
  free(share);
  return 0;
}

/* Divides `values` by a variance; whether any is then above level times its limit. */
static int any_above(long n, float *values, float variance, float level, const float *limit) {
  const int width = vector_width(n);
  return AT_WIDTH(width, any_above, n, values, variance, level, limit);
}

#endif
