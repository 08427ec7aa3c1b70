/* The loops of looks.h for vectors of one width; see widths.h. */

TARGET static void NAME(look_at)(long n, const float *x, struct looks *out) {
  const NAME(vec) none = {0};
  NAME(vec) lowest = INFINITY + none, highest = -lowest, above = none, squared = none, below = none;
  NAME(bits) known = {0};
  long i = 0;
  for (; i + WIDTH <= n; i += WIDTH) {
    const NAME(vec) value = *(const NAME(loose) *)(x + i);
    const NAME(vec) positive = SELECT(value < 0, none, value), negative = SELECT(value > 0, none, value);
    lowest = SELECT(value < lowest, value, lowest);
    highest = SELECT(value > highest, value, highest);
    above += positive;
    squared += positive * positive;
    below += negative * negative;
    known -= value == value;
  }
  for (int j = 0; j < WIDTH; j++) {
    out->lowest = lowest[j] < out->lowest ? lowest[j] : out->lowest;
    out->highest = highest[j] > out->highest ? highest[j] : out->highest;
    out->above += above[j], out->above_squared += squared[j], out->below_squared += below[j];
    out->known += known[j];
  }
  for (; i < n; i++) {
    const float positive = x[i] < 0 ? 0 : x[i], negative = x[i] > 0 ? 0 : x[i];
    out->lowest = x[i] < out->lowest ? x[i] : out->lowest;
    out->highest = x[i] > out->highest ? x[i] : out->highest;
    out->above += positive, out->above_squared += positive * positive, out->below_squared += negative * negative;
    out->known += x[i] == x[i];
  }
}

TARGET static float NAME(dot)(long n, const float *a, const float *b) {
  float sum = 0;
  for (long i = 0; i < n; i++) sum += a[i] * b[i];
  return sum;
}

TARGET static int NAME(any_above)(long n, float *values, float variance, float level, const float *limit) {
  int above = 0;
  for (long i = 0; i < n; i++) {
    values[i] /= variance;
    above |= values[i] > level * limit[i];
  }
  return above;
}

/* Sums over REACH rows on either side, then over as many columns, times the share of each in its sum: fewer at the
   border. A row that is summed over is in `between` (columns + 2 REACH), zeros at both its ends. */
TARGET static void NAME(window_means)(const float *x, long rows, long columns, const float *down, const float *across,
                                      float *between, float *out) {
  float *row = between + REACH;
  for (long i = 0; i < rows; i++) {
    const long first = i > REACH ? i - REACH : 0, last = i + REACH < rows ? i + REACH : rows - 1;
    for (long j = 0; j < columns; j++) row[j] = x[first * columns + j];
    for (long k = first + 1; k <= last; k++)
      for (long j = 0; j < columns; j++) row[j] += x[k * columns + j];
    for (long j = 0; j < columns; j++)
      out[i * columns + j] =
          down[i] * across[j] * (between[j] + between[j + 1] + between[j + 2] + between[j + 3] + between[j + 4]);
  }
}
