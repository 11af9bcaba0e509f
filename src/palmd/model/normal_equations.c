/* The smoother's normal equations: weigh residuals, assemble the linearised equations, reduce them to the constants.

   The twin of `observer.normal_equations`, which documents them. All rows are `width` wide, a multiple of LANES:
   derivatives by the constants, then the right-hand side, then zeros. Matrices in the nodes are banded, with
   `band[d * n + i]` the entry (i + d, i). */

#pragma GCC optimize("unroll-loops")

#define LANES 8
#include "lanes.h"

#define NODE 2
#define BAND 4
#define MOST_WIDE 128
#define NEAR 32
#define ROWS 16 /* rows added to the corner at a time */
#define HIGH 4  /* rows of a tile held in registers, two registers wide, which share every load */

const long normal_equations_sizes[] = {NODE, LANES, MOST_WIDE};

typedef struct {
  double *band, *rows, *corner; /* (BAND, n), (n, width), (width, width), initially zero */
  long n, width;
  double pending[ROWS][MOST_WIDE] __attribute__((aligned(64)));
  int waiting;
} Sum;

/* to (HIGH rows at stride `across`, `columns` registers wide) += aᵀ b over `count` rows at stride `stride`; if `less`, the
   sum is computed first and subtracted */
INLINE void tile(double *to, long across, const double *a, const double *b, long stride, long count, const int columns,
                 const int less) {
  lane sums[HIGH][2];
  for (int i = 0; i < HIGH; i++)
    for (int c = 0; c < columns; c++) sums[i][c] = less ? EVERY(0.0) : load(to + i * across + c * WIDE);
  for (long r = 0; r < count; r++)
    for (int c = 0; c < columns; c++) {
      const lane right = load(b + r * stride + c * WIDE);
      for (int i = 0; i < HIGH; i++) sums[i][c] += a[r * stride + i] * right;
    }
  for (int i = 0; i < HIGH; i++)
    for (int c = 0; c < columns; c++) {
      double *at = to + i * across + c * WIDE;
      store(at, less ? load(at) - sums[i][c] : sums[i][c]);
    }
}

/* to (width, width) += rowsᵀ rows, upper triangle by blocks; arguments as in `tile` */
INLINE void square(double *to, const double *rows, long width, long stride, long count, const int less) {
  for (long i = 0; i < width; i += HIGH) {
    long j = i / WIDE * WIDE;
    for (; j + WIDE < width; j += 2 * WIDE)
      tile(to + i * width + j, width, rows + i, rows + j, stride, count, 2, less);
    if (j < width) tile(to + i * width + j, width, rows + i, rows + j, stride, count, 1, less);
  }
}

static void flush(Sum *sum) {
  square(sum->corner, sum->pending[0], sum->width, MOST_WIDE, sum->waiting, 0);
  sum->waiting = 0;
}

/* add one residual: `nodes` are its derivatives by the nodes from `first` on, its row is sum->pending[sum->waiting] */
static void add(Sum *sum, long first, const double *nodes, int count) {
  const double *row = sum->pending[sum->waiting];
  for (int a = 0; a < count; a++) {
    double *to = sum->rows + (first + a) * sum->width;
    for (long j = 0; j < sum->width; j += WIDE) store(to + j, load(to + j) + nodes[a] * load(row + j));
    for (int b = 0; b <= a; b++) sum->band[(a - b) * sum->n + first + b] += nodes[a] * nodes[b];
  }
  if (++sum->waiting == ROWS) flush(sum);
}

/* The k-th smallest entry of `a` (n), by quickselect; reorders `a` so that earlier entries are no larger. */
static double selected(double *a, long n, long k) {
  for (long first = 0, last = n - 1; first < last;) {
    const double pivot = a[(first + last) / 2];
    long i = first, j = last;
    while (i <= j) {
      while (a[i] < pivot) i++;
      while (a[j] > pivot) j--;
      if (i <= j) {
        const double other = a[i];
        a[i++] = a[j];
        a[j--] = other;
      }
    }
    if (k <= j) last = j;
    else if (k >= i) first = i;
    else break;
  }
  return a[k];
}

static double median(double *a, long n) {
  const double above = selected(a, n, n / 2);
  if (n % 2) return above;
  double below = a[0];
  for (long k = 1; k < n / 2; k++) below = a[k] > below ? a[k] : below;
  return (below + above) / 2;
}

/* Residuals, value − prediction, and their weights 1/σ, reduced for outliers: readings with a NIS beyond `gate`, which is
   widened by the median NIS if that is too large. `result`: cost; mean NIS without outliers; number of outliers; longest
   run of them. `room`: work array of n. */
void weigh(long n, const double *predicted, const double *value, const double *variance, const double *weight,
           double gate, double *residual, double *root, double *room, double *result) {
  for (long k = 0; k < n; k++) {
    residual[k] = value[k] - predicted[k];
    root[k] = room[k] = residual[k] * residual[k] / variance[k];
  }
  const double typical = n ? median(room, n) / 0.455 : 1.0;
  if (typical > 1.0) gate *= typical;
  double cost = 0.0, square = 0.0;
  long outliers = 0, run = 0, longest = 0;
  for (long k = 0; k < n; k++) {
    const double nis = root[k];
    if (nis > gate) {
      outliers++;
      if (++run > longest) longest = run;
      cost += weight[k] * gate * (1.0 + log(nis / gate));
      root[k] = sqrt(gate / nis * weight[k] / variance[k]);
    } else {
      run = 0;
      square += nis;
      cost += weight[k] * nis;
      root[k] = sqrt(weight[k] / variance[k]);
    }
  }
  result[0] = cost;
  result[1] = square / (n - outliers);
  result[2] = outliers;
  result[3] = longest;
}

typedef struct {
  const double *x, *end, *jacobian, *root; /* nodes (K + 1, NODE); (K, NODE), (K, NODE + constants, NODE); (K, NODE) */
  long steps, constants, width;
} Steps;

typedef struct {
  const double *gradient, *residual, *root; /* (count, 2 NODE + constants); value − prediction; 1/σ */
  const long *step;
  long count;
} Readings;

/* Add the equations of all steps and readings; returns the process cost, the weighed sum of squares of the steps. */
double assemble(const Steps *steps, const Readings *kinds, long number, double *band, double *rows, double *corner) {
  const long constants = steps->constants, width = steps->width, n = NODE * (steps->steps + 1);
  Sum sum = {.band = band, .rows = rows, .corner = corner, .n = n, .width = width};
  double process_cost = 0.0;
  for (long k = 0; k < steps->steps; k++) {
    const double *J = steps->jacobian + k * (NODE + constants) * NODE;
    for (int i = 0; i < NODE; i++) {
      const double root = steps->root[k * NODE + i];
      const double miss = (steps->end[k * NODE + i] - steps->x[(k + 1) * NODE + i]) * root;
      double nodes[2 * NODE] = {J[i] * root, J[NODE + i] * root}, *row = sum.pending[sum.waiting];
      nodes[NODE + i] = -root;
      for (long c = 0; c < constants; c++) row[c] = J[(NODE + c) * NODE + i] * root;
      row[constants] = -miss;
      for (long c = constants + 1; c < width; c++) row[c] = 0.0;
      process_cost += miss * miss;
      add(&sum, NODE * k, nodes, 2 * NODE);
    }
  }
  for (const Readings *kind = kinds; kind < kinds + number; kind++)
    for (long k = 0; k < kind->count; k++) {
      const double *gradient = kind->gradient + k * (2 * NODE + constants), root = kind->root[k];
      double nodes[2 * NODE], *row = sum.pending[sum.waiting];
      for (int a = 0; a < 2 * NODE; a++) nodes[a] = gradient[a] * root;
      for (long c = 0; c < constants; c++) row[c] = gradient[2 * NODE + c] * root;
      row[constants] = kind->residual[k] * root;
      for (long c = constants + 1; c < width; c++) row[c] = 0.0;
      add(&sum, NODE * kind->step[k], nodes, 2 * NODE);
    }
  flush(&sum);
  for (long i = 0; i < width; i++)
    for (long j = 0; j < i; j++) corner[i * width + j] = corner[j * width + i];
  return process_cost;
}

/* Cholesky factor L of the band plus `damping` (NODE) on its diagonal, n by n, into `factor` (BAND, n); rows become
   L⁻¹ rows (n, width), and rowsᵀ rows is subtracted from `left` (width, width). `width` is a multiple of LANES. Returns 0,
   or 1 if the matrix is not positive definite. */
int reduce(const double *band, long stride, long n, const double *damping, double *factor, double *rows, long width,
           double *left) {
  for (long i = 0; i < n; i++) {
    double l[BAND]; /* of row i: at i, i − 1, … */
    for (int d = BAND - 1; d >= 0; d--) {
      if (d > i) {
        l[d] = 0.0;
        continue;
      }
      const long j = i - d;
      double a = band[d * stride + j] + (d ? 0.0 : damping[i % NODE]);
      for (int e = d + 1; e < BAND && e <= i; e++) a -= l[e] * factor[(e - d) * n + i - e];
      if (d == 0) {
        if (!(a > 0.0) || a > 1.7e308) return 1;
        a = sqrt(a);
      } else {
        a /= factor[j];
      }
      factor[d * n + j] = l[d] = a;
    }
    double *row = rows + i * width;
    for (long c = 0; c < width; c += WIDE) {
      lane a = load(row + c);
      for (int d = 1; d < BAND && d <= i; d++) a -= l[d] * load(row - d * width + c);
      store(row + c, a / l[0]);
    }
  }
  for (long first = 0; first < n; first += NEAR) /* a few rows at a time stay in the L1 cache */
    square(left, rows + first * width, width, width, n - first < NEAR ? n - first : NEAR, 1);
  for (long i = 0; i < width; i++)
    for (long j = 0; j < i; j++) left[i * width + j] = left[j * width + i];
  return 0;
}

/* x (n) = L⁻ᵀ (rows · by), by (width) */
void back(const double *factor, long n, const double *rows, long width, const double *by, double *x) {
  for (long i = n - 1; i >= 0; i--) {
    double a = 0.0;
    for (long c = 0; c < width; c++) a += rows[i * width + c] * by[c];
    for (int d = 1; d < BAND && i + d < n; d++) a -= factor[d * n + i] * x[i + d];
    x[i] = a / factor[i];
  }
}
