/* The loops of products.h for vectors of one width; see widths.h. */

/* out (m, n) = A B, with A[i, k] at a[i down + k across] and B (l, n): ROWS rows and WIDTH columns at a time. */
TARGET static void NAME(product)(long m, long n, long l, const float *a, long down, long across, const float *b,
                                 float *out) {
  for (long column = 0; column < n; column += WIDTH) {
    if (column + WIDTH > n) column = n - WIDTH;
    for (long row = 0; row < m; row += ROWS) {
      const float *rows[ROWS];
      NAME(vec) sums[ROWS] = {0};
      for (int j = 0; j < ROWS; j++) rows[j] = a + (row + j < m ? row + j : m - 1) * down;
      for (long k = 0; k < l; k++) {
        const NAME(vec) x = *(const NAME(loose) *)(b + k * n + column);
        for (int j = 0; j < ROWS; j++) sums[j] += rows[j][k * across] * x;
      }
      for (int j = 0; j < ROWS && row + j < m; j++) *(NAME(loose) *)(out + (row + j) * n + column) = sums[j];
    }
  }
}
