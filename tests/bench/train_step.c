/* The gradient of what `tests.bench.train` minimises, by hand: eight samples of one skin at a time, one in each lane.

   Images lie in a raster with a border of zeros, so that a shift of a kernel is a step in memory. Names are those of
   `network` in train.py: a stage sees five images, its filters' outputs are `seen`, and what they draw is added to the
   first image, which is then held to the frame in the modes V, W of a blur. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LANES = 8, FILTERS = 24, TAPS = 9, IMAGES = 5, STAGES = 3, OF_STAGE = 2 * FILTERS + 1 };
enum { TUNED = STAGES * OF_STAGE + 1, KERNELS = TAPS * IMAGES * FILTERS };
typedef float lanes __attribute__((vector_size(4 * LANES)));
typedef int bits __attribute__((vector_size(4 * LANES)));
typedef const lanes *const *images;

static lanes all(float x) { return (lanes){x, x, x, x, x, x, x, x}; }
static lanes where_positive(lanes x, lanes of) { return (lanes)((bits)x & (of > 0)); }

static float sum(lanes x) {
  float total = 0;
  for (int l = 0; l < LANES; l++) total += x[l];
  return total;
}

/* out[f][p] = sum_{n, i} kernels[n][i][f] in[i][p + shift[n]], of `count` images, p from `first` to `end` */
static void spread(images in, int count, const int *shift, const float *kernels, lanes *const *out, int first, int end) {
  for (int f = 0; f < FILTERS; f += 6)
    for (int p = first; p < end; p += 2) {
      lanes total[6][2] = {0};
      for (int n = 0; n < TAPS; n++)
        for (int i = 0; i < count; i++) {
          const lanes *x = in[i] + p + shift[n];
          const float *k = kernels + (n * count + i) * FILTERS + f;
          lanes one = x[0], next = x[1];
          for (int j = 0; j < 6; j++) total[j][0] += all(k[j]) * one, total[j][1] += all(k[j]) * next;
        }
      for (int j = 0; j < 6; j++) out[f + j][p] = total[j][0], out[f + j][p + 1] = total[j][1];
    }
}

/* one[p] = sum_{n, f} kernels[n][f][0] in[f][p + shift[n]], and the same for `other` with kernels[..][1] */
static void gather(images in, const int *shift, const float *kernels, lanes *one, lanes *other, int first, int end) {
  for (int p = first; p < end; p += 6) {
    lanes a[6] = {0}, b[6] = {0};
    for (int n = 0; n < TAPS; n++)
      for (int f = 0; f < FILTERS; f++) {
        const lanes *x = in[f] + p + shift[n];
        const float *k = kernels + 2 * (n * FILTERS + f);
        for (int j = 0; j < 6; j++) a[j] += all(k[0]) * x[j], b[j] += all(k[1]) * x[j];
      }
    for (int j = 0; j < 6; j++) one[p + j] = a[j], other[p + j] = b[j];
  }
}

/* out[n][i][f] += sum_p of[f][p] in[i][p + shift[n]], over the rows of an image; `out` is of lanes, to be summed */
static void correlate(images in, int count, images of, int rows, int stride, lanes *out) {
  for (int row = 1; row <= rows; row++)
    for (int down = 0; down < 3; down++)
      for (int i = 0; i < count; i++) {
        const lanes *x = in[i] + (down - 1) * stride;
        lanes *at = out + (3 * down * count + i) * FILTERS;
        const int next = count * FILTERS;
        for (int f = 0; f < FILTERS; f += 4) {
          lanes total[3][4];
          for (int n = 0; n < 3; n++)
            for (int j = 0; j < 4; j++) total[n][j] = at[n * next + f + j];
          for (int p = row * stride + 1; p < (row + 1) * stride - 1; p++)
            for (int j = 0; j < 4; j++) {
              lanes y = of[f + j][p];
              total[0][j] += x[p - 1] * y, total[1][j] += x[p] * y, total[2][j] += x[p + 1] * y;
            }
          for (int n = 0; n < 3; n++)
            for (int j = 0; j < 4; j++) at[n * next + f + j] = total[n][j];
        }
      }
}

/* Add to out[n][f] the sums of of[p] in[f][p + shift[n]]. */
static void correlate_one(images in, const lanes *of, int rows, int stride, float *out) {
  for (int down = 0; down < 3; down++)
    for (int f = 0; f < FILTERS; f++) {
      const lanes *x = in[f] + (down - 1) * stride;
      lanes total[3] = {0};
      for (int row = 1; row <= rows; row++)
        for (int p = row * stride + 1; p < (row + 1) * stride - 1; p++)
          total[0] += of[p] * x[p - 1], total[1] += of[p] * x[p], total[2] += of[p] * x[p + 1];
      for (int n = 0; n < 3; n++) out[(3 * down + n) * FILTERS + f] += sum(total[n]);
    }
}

/* out = A x B', of x (R, C) whose rows lie `stride` apart; A (R, R), B (C, C), out and `between` (R, C) */
static void twice(const float *A, const float *B, const lanes *x, int stride, lanes *out, int R, int C, lanes *between) {
  for (int m = 0; m < R; m++)
    for (int c = 0; c < C; c++) {
      lanes total = all(0);
      for (int r = 0; r < R; r++) total += all(A[m * R + r]) * x[r * stride + c];
      between[m * C + c] = total;
    }
  for (int m = 0; m < R; m++)
    for (int k = 0; k < C; k++) {
      lanes total = all(0);
      for (int c = 0; c < C; c++) total += between[m * C + c] * all(B[k * C + c]);
      out[m * C + k] = total;
    }
}

static void clear_border(lanes *x, int rows, int stride) {
  for (int c = 0; c < stride; c++) x[c] = x[(rows + 1) * stride + c] = all(0);
  for (int r = 0; r < rows + 2; r++) x[r * stride] = x[(r + 1) * stride - 1] = all(0);
}

/* Eight samples of a skin of R x C cells. Samples: linear, c, truths (8, R, C), noise (8,), tuned (8, TUNED), and pull
   (STAGES, 8): what the squared relative error of each stage counts. The skin: maps (2, R, C), gain (R, C), V (R, R),
   W (C, C). Weights: redraw (STAGES, FILTERS, 45), draw (STAGES, 9, FILTERS), doubt (9, FILTERS). terms: AROUND,
   TOUCHED, WITHIN, UNPRESSED, what a sample's doubt counts, FIRMNESS. Gives the squared errors (STAGES, 8), counts of
   pressed cells and those within two deviations (2,), the last images and doubts (8, R, C), and adds the gradients.
   Not 0: no memory. */
int train_step(int R, int C, const float *linear, const float *c, const float *truths, const float *noise,
               const float *tuned, const float *pull, const float *maps, const float *gain, const float *V,
               const float *W, const float *redraw, const float *draw, const float *doubt, const float *terms,
               float *squares, float *counts, float *last, float *doubts, float *to_redraw, float *to_draw,
               float *to_doubt, float *to_tuned) {
  const float around = terms[0], touched = terms[1], within = terms[2], unpressed = terms[3], counted = terms[4];
  const int stride = C + 2, cells = R * C, first = stride, end = (R + 1) * stride;
  const int size = (R + 2) * stride + 2 * stride + 16; /* shifts and steps of six reach beyond both ends */
  const int count = 3 + 2 * (STAGES + 1) + (2 * STAGES + 1) * FILTERS + 6;
  lanes *memory = aligned_alloc(64, ((size_t)count * size + (6 + STAGES) * cells + KERNELS) * sizeof(lanes));
  if (!memory) return 1;
  memset(memory, 0, ((size_t)count * size + (6 + STAGES) * cells + KERNELS) * sizeof(lanes));
  lanes *next = memory + stride + 2;
#define IMAGE (next += size, next - size)
  lanes *start = IMAGE, *felt = IMAGE, *own = IMAGE, *of_stage[STAGES + 1][IMAGES];
  lanes *filtered[STAGES][FILTERS], *seen[STAGES][FILTERS], *back[FILTERS];
  for (int s = 0; s <= STAGES; s++) {
    of_stage[s][0] = IMAGE, of_stage[s][1] = IMAGE;
    of_stage[s][2] = start, of_stage[s][3] = felt, of_stage[s][4] = own;
  }
  for (int f = 0; f < FILTERS; f++) {
    back[f] = IMAGE;
    for (int s = 0; s < STAGES; s++) filtered[s][f] = IMAGE, seen[s][f] = IMAGE;
  }
  lanes *drawn = IMAGE, *doubted = IMAGE, *to_doubted = IMAGE, *to_held = IMAGE, *to_redrawn = IMAGE, *other = IMAGE;
  lanes *at = next - stride - 2, *coefficients = at, *truth = at + cells, *one = at + 2 * cells, *two = at + 3 * cells;
  lanes *between = at + 4 * cells, *missed[STAGES], *kernels = at + (6 + STAGES) * cells;
  for (int s = 0; s < STAGES; s++) missed[s] = at + (5 + s) * cells;
  int shift[TAPS], reverse[TAPS];
  for (int n = 0; n < TAPS; n++) shift[n] = (n / 3 - 1) * stride + n % 3 - 1, reverse[n] = -shift[n];
  float Vt[R * R], Wt[C * C], of_image[STAGES][KERNELS], pairs[2 * TAPS * FILTERS];
  for (int i = 0; i < R * R; i++) Vt[i % R * R + i / R] = V[i];
  for (int i = 0; i < C * C; i++) Wt[i % C * C + i / C] = W[i];
  for (int s = 0; s < STAGES; s++)
    for (int f = 0; f < FILTERS; f++)
      for (int i = 0; i < TAPS * IMAGES; i++) of_image[s][i * FILTERS + f] = redraw[(s * FILTERS + f) * TAPS * IMAGES + i];
#define PLACE(i) (((i) / C + 1) * stride + (i) % C + 1)
  for (int i = 0; i < cells; i++) {
    felt[PLACE(i)] = all(maps[i]), own[PLACE(i)] = all(maps[cells + i]);
    for (int l = 0; l < LANES; l++) {
      start[PLACE(i)][l] = linear[l * cells + i];
      coefficients[i][l] = c[l * cells + i], truth[i][l] = truths[l * cells + i];
    }
    of_stage[0][1][PLACE(i)] = start[PLACE(i)];
    of_stage[0][0][PLACE(i)] = where_positive(start[PLACE(i)], start[PLACE(i)]);
  }
  lanes scales[STAGES][FILTERS], offsets[STAGES][FILTERS], firm[STAGES];
  for (int s = 0; s < STAGES; s++)
    for (int l = 0; l < LANES; l++) {
      const float *t = tuned + l * TUNED + s * OF_STAGE;
      for (int f = 0; f < FILTERS; f++) scales[s][f][l] = t[f], offsets[s][f][l] = t[FILTERS + f];
      firm[s][l] = noise[l] * noise[l] * expf(terms[5] * t[2 * FILTERS] + terms[6]);
    }

  for (int s = 0; s < STAGES; s++) {
    spread((images)of_stage[s], IMAGES, shift, of_image[s], filtered[s], first, end);
    for (int f = 0; f < FILTERS; f++) {
      for (int p = first; p < end; p++) {
        lanes z = filtered[s][f][p] * scales[s][f] + offsets[s][f];
        seen[s][f][p] = where_positive(z, z);
      }
      clear_border(seen[s][f], R, stride);
    }
    for (int i = 0; i < TAPS * FILTERS; i++) pairs[2 * i] = draw[s * TAPS * FILTERS + i], pairs[2 * i + 1] = doubt[i];
    gather((images)seen[s], shift, pairs, drawn, doubted, first, end);
    lanes *held = of_stage[s + 1][0], *redrawn = of_stage[s + 1][1];
    for (int i = 0; i < cells; i++) redrawn[PLACE(i)] = of_stage[s][0][PLACE(i)] + drawn[PLACE(i)];
    twice(Vt, Wt, redrawn + stride + 1, stride, one, R, C, between);
    for (int i = 0; i < cells; i++) {
      missed[s][i] = coefficients[i] - all(gain[i]) * one[i];
      two[i] = all(gain[i]) * missed[s][i] / (all(gain[i] * gain[i]) + firm[s]);
    }
    twice(V, W, two, C, one, R, C, between);
    for (int i = 0; i < cells; i++) held[PLACE(i)] = redrawn[PLACE(i)] + one[i];
  }

  lanes scale = all(0), peak = all(0), weights = all(1e-9f);
  for (int i = 0; i < cells; i++) {
    const float in = maps[cells + i];
    scale += all(in + around * (1 - in)) * truth[i] * truth[i];
    for (int l = 0; l < LANES; l++) peak[l] = fmaxf(peak[l], truth[i][l]);
  }
  for (int s = 0; s < STAGES; s++) {
    lanes total = all(0);
    for (int i = 0; i < cells; i++) {
      const float in = maps[cells + i];
      lanes image = of_stage[s + 1][0][PLACE(i)], error = where_positive(image, image) - truth[i];
      total += all(in + around * (1 - in)) * error * error;
    }
    for (int l = 0; l < LANES; l++) squares[s * LANES + l] = total[l] / scale[l];
  }
#define PRESSED(i, l) (truth[i][l] > touched * peak[l])
  for (int i = 0; i < cells; i++)
    for (int l = 0; l < LANES; l++) weights[l] += maps[cells + i] * (PRESSED(i, l) ? 1 : unpressed);
  for (int l = 0; l < LANES; l++)
    for (int i = 0; i < cells; i++) {
      const float in = maps[cells + i], said = doubted[PLACE(i)][l] + tuned[(l + 1) * TUNED - 1];
      const float image = fmaxf(of_stage[STAGES][0][PLACE(i)][l], 0);
      const float over = logf(fabsf(image - truth[i][l]) + 1e-5f) - said - logf(2);
      const float slope = (1 - within - (over > 0)) * in * (PRESSED(i, l) ? 1 : unpressed) / weights[l] * counted;
      last[l * cells + i] = image, doubts[l * cells + i] = said;
      counts[0] += in * PRESSED(i, l), counts[1] += in * (PRESSED(i, l) && over < 0);
      to_doubted[PLACE(i)][l] = slope, to_tuned[(l + 1) * TUNED - 1] += slope;
    }

  for (int s = STAGES - 1; s >= 0; s--) {
    const lanes *held = of_stage[s + 1][0];
    for (int i = 0; i < cells; i++) {
      const float in = maps[cells + i];
      for (int l = 0; l < LANES; l++) /* of the error's square */
        if (held[PLACE(i)][l] > 0)
          to_held[PLACE(i)][l] += 2 * pull[s * LANES + l] * (in + around * (1 - in)) / scale[l] * (held[PLACE(i)][l] - truth[i][l]);
    }
    twice(Vt, Wt, to_held + stride + 1, stride, one, R, C, between);
    lanes to_firm = all(0);
    for (int i = 0; i < cells; i++) {
      lanes g = all(gain[i]), over = g * g + firm[s];
      to_firm -= one[i] * missed[s][i] * g / (over * over);
      two[i] = g * g * one[i] / over;
    }
    for (int l = 0; l < LANES; l++) to_tuned[l * TUNED + (s + 1) * OF_STAGE - 1] += to_firm[l] * firm[s][l] * terms[5];
    twice(V, W, two, C, one, R, C, between);
    for (int i = 0; i < cells; i++) to_redrawn[PLACE(i)] += to_held[PLACE(i)] - one[i];
    correlate_one((images)seen[s], to_redrawn, R, stride, to_draw + s * TAPS * FILTERS);
    const int both = s == STAGES - 1; /* the doubt is drawn by the last stage alone */
    if (both) correlate_one((images)seen[s], to_doubted, R, stride, to_doubt);
    for (int n = 0; n < TAPS; n++)
      for (int f = 0; f < FILTERS; f++) {
        pairs[(1 + both) * n * FILTERS + f] = draw[(s * TAPS + n) * FILTERS + f];
        if (both) pairs[(2 * n + 1) * FILTERS + f] = doubt[n * FILTERS + f];
      }
    const lanes *through[2] = {to_redrawn, to_doubted};
    spread(through, 1 + both, reverse, pairs, back, first, end);
    for (int f = 0; f < FILTERS; f++) {
      lanes to_scale = all(0), to_offset = all(0);
      clear_border(back[f], R, stride);
      for (int p = first; p < end; p++) {
        lanes slope = where_positive(back[f][p], seen[s][f][p]);
        to_scale += slope * filtered[s][f][p], to_offset += slope;
        back[f][p] = slope * scales[s][f];
      }
      for (int l = 0; l < LANES; l++) {
        to_tuned[l * TUNED + s * OF_STAGE + f] += to_scale[l];
        to_tuned[l * TUNED + s * OF_STAGE + FILTERS + f] += to_offset[l];
      }
    }
    memset(kernels, 0, KERNELS * sizeof(lanes));
    correlate((images)of_stage[s], IMAGES, (images)back, R, stride, kernels);
    for (int f = 0; f < FILTERS; f++)
      for (int i = 0; i < TAPS * IMAGES; i++)
        to_redraw[(s * FILTERS + f) * TAPS * IMAGES + i] += sum(kernels[i * FILTERS + f]);
    if (!s) break;
    for (int n = 0; n < TAPS * FILTERS; n++)
      for (int i = 0; i < 2; i++) pairs[2 * n + i] = of_image[s][(n / FILTERS * IMAGES + i) * FILTERS + n % FILTERS];
    gather((images)back, reverse, pairs, drawn, other, first, end);
    for (int i = 0; i < cells; i++) {
      to_held[PLACE(i)] = to_redrawn[PLACE(i)] + drawn[PLACE(i)];
      to_redrawn[PLACE(i)] = other[PLACE(i)];
    }
  }
  free(memory);
  return 0;
}
