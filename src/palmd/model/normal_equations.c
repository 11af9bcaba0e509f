/* The smoother's normal equations: assembled from linearised residuals, and reduced to the constants.

   The twin of `observer.normal_equations`, which says what they are. All rows are `width` wide, a multiple of
   LANES: what they are in the constants, then the right-hand side, then zeros. Matrices in the nodes are banded, `band[d * n + i]` being the entry
   (i + d, i). */

#pragma GCC optimize("unroll-loops")

#define LANES 8
#include "lanes.h"

#define NODE 2
#define BAND 4
#define MOST_WIDE 128
#define NEAR 32
#define ROWS 4 /* that are added to the corner at a time */

const long normal_equations_sizes[] = {NODE, LANES, MOST_WIDE};

typedef struct {
  double *band, *rows, *corner; /* (BAND, n), (n, width), (width, width), all zero to begin with */
  long n, width;
  double pending[ROWS][MOST_WIDE] __attribute__((aligned(64)));
  int waiting;
} Sum;

INLINE lane load(const double *from) { lane a; memcpy(&a, from, sizeof a); return a; }
INLINE void store(double *to, lane a) { memcpy(to, &a, sizeof a); }

/* corner += pendingᵀ pending, its upper triangle by blocks */
static void flush(Sum *sum) {
  for (int r = sum->waiting; r < ROWS; r++) memset(sum->pending[r], 0, sizeof sum->pending[r]);
  for (long i = 0; i < sum->width; i++) {
    double *row = sum->corner + i * sum->width;
    for (long j = i / WIDE * WIDE; j < sum->width; j += WIDE) {
      lane a = load(row + j);
      for (int r = 0; r < ROWS; r++) a += sum->pending[r][i] * load(sum->pending[r] + j);
      store(row + j, a);
    }
  }
  sum->waiting = 0;
}

/* one residual: `nodes` are its derivatives in the nodes from `first` on, the row is in sum->pending[sum->waiting] */
static void add(Sum *sum, long first, const double *nodes, int count) {
  const double *row = sum->pending[sum->waiting];
  for (int a = 0; a < count; a++) {
    double *to = sum->rows + (first + a) * sum->width;
    for (long j = 0; j < sum->width; j += WIDE) store(to + j, load(to + j) + nodes[a] * load(row + j));
    for (int b = 0; b <= a; b++) sum->band[(a - b) * sum->n + first + b] += nodes[a] * nodes[b];
  }
  if (++sum->waiting == ROWS) flush(sum);
}

typedef struct {
  const double *x, *end, *jacobian, *root; /* nodes (K + 1, NODE); (K, NODE), (K, NODE + constants, NODE); (K, NODE) */
  long steps, constants, width;
} Steps;

typedef struct {
  const double *gradient, *residual, *root; /* (count, 2 NODE + constants); value − prediction; one over the one-sigma */
  const long *step;
  long count;
} Readings;

/* What the steps' ends and the readings say; the sum of the steps' squares is returned. */
double assemble(const Steps *steps, const Readings *kinds, long number, double *band, double *rows, double *corner) {
  const long constants = steps->constants, width = steps->width, n = NODE * (steps->steps + 1);
  Sum sum = {.band = band, .rows = rows, .corner = corner, .n = n, .width = width};
  double slack = 0.0;
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
      slack += miss * miss;
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
  return slack;
}

/* Cholesky's factor L of the band plus `damping` (NODE) on its diagonal, n by n, into `factor` (BAND, n); rows become
   L⁻¹ rows (n, width), and `left`, (width, width), loses rowsᵀ rows. `width` is a multiple of LANES. 0, or 1 where the
   matrix is not positive definite. */
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
  for (long first = 0; first < n; first += NEAR) { /* a few rows at a time stay in the fastest memory */
    const long last = first + NEAR < n ? first + NEAR : n;
    for (long i = 0; i < width; i++)
      for (long c = i / WIDE * WIDE; c < width; c += WIDE) {
        lane a = {0.0};
        for (long r = first; r < last; r++) a += rows[r * width + i] * load(rows + r * width + c);
        store(left + i * width + c, load(left + i * width + c) - a);
      }
  }
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
