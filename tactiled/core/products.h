/* Products of small matrices, float32, in rows that follow one another in memory. */

#ifndef CORE_PRODUCTS
#define CORE_PRODUCTS

#define ROWS 8 /* whose sums stay in registers */
#define BODY "products_body.h"
#include "widths.h"
#undef BODY

static void product(long m, long n, long l, const float *a, long down, long across, const float *b, float *out) {
  if (n >= 4) {
    const int width = vector_width(n);
    AT_WIDTH(width, product, m, n, l, a, down, across, b, out);
    return;
  }
  for (long i = 0; i < m; i++)
    for (long j = 0; j < n; j++) {
      float sum = 0;
      if (n == 1 && across == 1)
        for (long k = 0; k < l; k++) sum += a[i * down + k] * b[k];
      else
        for (long k = 0; k < l; k++) sum += a[i * down + k * across] * b[k * n + j];
      out[i * n + j] = sum;
    }
}

#endif
