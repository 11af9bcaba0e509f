/* The linearised least-squares problem of one record of a body between three palms; `observer.three_palms.equations`
   documents it. Arrays belong to the caller; no state is kept. Kernels, whose matrices are column-major, are passed by
   address. */

#define LANES 8
#include "lanes.h"
#include "turns.h"

#define STATES 6
#define PALM_INPUTS 36
#define RIG_INPUTS 2
#define GEOMETRY 24
#define OF_STEP 6 /* residuals of the equations of motion per interval: turn and spin */
#define CHUNK 32  /* instants per kernel call, so that their results stay in the processor's cache */
#define SIDES (2 * STATES)

const long body_equations_sizes[] = {STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OF_STEP, CHUNK};

typedef void Kernel(const double *const *in, double *const *out, long columns);

typedef struct {
  Kernel *acceleration, *reading; /* without parameter Jacobians if `parameters` is 0 */
  long parameters, harmonics;
  double rig[RIG_INPUTS];
} Model;

typedef struct {
  const double *node_palms, *middle_palms, *geometry, *share, *value;
  const int64_t *first; /* (intervals + 1,) index of the first reading of each interval */
  long intervals;
  double spacing;
  double reading, spin, by_spin, turn; /* the noise */
} Record;

/* Rows: for each interval those of its equations, then two for each of its readings. r (rows,); sides (rows, 12):
   Jacobians in the nodes before and after; by (rows, m): in the parameters. The others as in `Arrow`, initially zero. */
typedef struct {
  double *r, *sides, *by, *diagonal, *upper, *border, *nodes_gradient, *gradient, *residual, *force;
} Equations;

typedef struct {
  double alpha[CHUNK][3], force[CHUNK][3], by_turn[CHUNK][9], by_omega[CHUNK][9], *by_p; /* (CHUNK, m, 3) */
} Accelerations;

static long columns_of(long count) { return (count + LANES - 1) / LANES * LANES; }

/* copy `count` rows of `size` numbers, padded to a multiple of LANES rows with the last one */
static void lay_out(double *to, const double *from, long count, long size) {
  memcpy(to, from, count * size * sizeof *to);
  for (long i = count; i < columns_of(count); i++) memcpy(to + i * size, from + (count - 1) * size, size * sizeof *to);
}

static void lay_out_by_columns(double (*to)[9], const double *R, long count) {
  for (long k = 0; k < columns_of(count); k++)
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) to[k][3 * j + i] = R[9 * (k < count ? k : count - 1) + 3 * i + j];
}

static void accelerate(const Model *model, long count, const double *R, const double *omega, const double *palms,
                       const double *p, Accelerations *result) {
  double turned[CHUNK][9], spin[CHUNK][3], palm[CHUNK][PALM_INPUTS];
  lay_out_by_columns(turned, R, count);
  lay_out(spin[0], omega, count, 3);
  lay_out(palm[0], palms, count, PALM_INPUTS);
  const double *in[] = {turned[0], spin[0], palm[0], p, model->rig};
  double *out[] = {result->alpha[0], result->force[0], result->by_turn[0], result->by_omega[0], result->by_p};
  model->acceleration(in, out, columns_of(count));
}

/* v <- rotation vector from R to `next` */
static void turn_between(const double *R, const double *next, double *v) {
  double D[3][3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) D[i][j] = dot(next + 3 * i, R + 3 * j);
  v[0] = (D[2][1] - D[1][2]) / 2, v[1] = (D[0][2] - D[2][0]) / 2, v[2] = (D[1][0] - D[0][1]) / 2;
  const double angle = atan2(sqrt(dot(v, v)), (D[0][0] + D[1][1] + D[2][2] - 1.0) / 2);
  for (int i = 0; i < 3; i++) v[i] /= sinc(angle);
}

/* M <- `rotation.left_inverse` of sign * v */
static void left_inverse(const double *v, double sign, double M[3][3]) {
  const double square = dot(v, v), S[3][3] = {{0, -v[2], v[1]}, {v[2], 0, -v[0]}, {-v[1], v[0], 0}};
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      M[i][j] = (i == j) - sign * S[i][j] / 2 + (v[i] * v[j] - (i == j) * square) / 12;
}

/* to <- E M, all column-major */
static void product(const double *E, const double *M, double *to) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) to[3 * j + i] = E[i] * M[3 * j] + E[3 + i] * M[3 * j + 1] + E[6 + i] * M[3 * j + 2];
}

typedef struct {
  double phi[3], ending[3], R[9], omega[3]; /* turn over the interval, its rate at the end; state in the middle */
} Between;

static void go_between(double h, const double *R, const double *omega, const double *f, Between *at) {
  const double *w0 = omega, *w1 = omega + 3, *f0 = f, *f1 = f + 3;
  double across[3], v[3];
  turn_between(R, R + 9, at->phi);
  cross(at->phi, w1, across);
  for (int i = 0; i < 3; i++) {
    at->ending[i] = w1[i] - across[i] / 2;
    at->omega[i] = (w0[i] + w1[i]) / 2 + h / 8 * (f0[i] - f1[i]);
    v[i] = at->phi[i] / 2 + h / 8 * (w0[i] - at->ending[i]);
  }
  turned(v, R, at->R);
}

/* rows of the equations of motion of one interval; k: its index in `nodes` and `middles` */
static void step_rows(const Record *record, long m, const double *omega, const Between *at, const Accelerations *nodes,
                      const Accelerations *middles, long k, double *r, double *sides, double *by) {
  const double h = record->spacing, sixth = h / 6, twelfth = h * h / 12, *w0 = omega, *w1 = omega + 3;
  const double *f0 = nodes->alpha[k], *f1 = nodes->alpha[k + 1], *fm = middles->alpha[k];
  const double *turn0 = nodes->by_turn[k], *turn1 = nodes->by_turn[k + 1], *turn_m = middles->by_turn[k];
  const double *omega0 = nodes->by_omega[k], *omega1 = nodes->by_omega[k + 1], *omega_m = middles->by_omega[k];
  const double turn_weight = 1.0 / sqrt(record->turn * h);
  const double spin_weight = 1.0 / sqrt((record->spin + record->by_spin * dot(at->omega, at->omega)) * h);
  double across[3], eighth[9], before[3][3], after[3][3], turns0[9], turns1[9], omegas0[9], omegas1[9];
  cross(w1, w0, across);
  for (int i = 0; i < 9; i++) eighth[i] = h / 8 * omega_m[i];
  left_inverse(at->phi, -1.0, before), left_inverse(at->phi, 1.0, after);
  product(eighth, turn0, turns0), product(eighth, turn1, turns1);
  product(eighth, omega0, omegas0), product(eighth, omega1, omegas1);
  const double S0[3][3] = {{0, -w0[2], w0[1]}, {w0[2], 0, -w0[0]}, {-w0[1], w0[0], 0}};
  const double S1[3][3] = {{0, -w1[2], w1[1]}, {w1[2], 0, -w1[0]}, {-w1[1], w1[0], 0}};
  for (int i = 0; i < 3; i++) {
    const double by_turn = at->phi[i] - sixth * (w0[i] + 4 * at->omega[i] + w1[i]) - twelfth * across[i];
    r[i] = turn_weight * by_turn;
    r[3 + i] = spin_weight * (w1[i] - w0[i] - sixth * (f0[i] + 4 * fm[i] + f1[i]));
    double *of_turn = sides + i * SIDES, *of_spin = sides + (3 + i) * SIDES;
    for (int j = 0; j < 3; j++) {
      const int c = 3 * j + i;
      const double one = i == j;
      of_turn[j] = turn_weight * (-before[i][j] - twelfth * turn0[c]);
      of_turn[3 + j] = turn_weight * (-h / 2 * one - twelfth * (omega0[c] + S1[i][j]));
      of_turn[6 + j] = turn_weight * (after[i][j] + twelfth * turn1[c]);
      of_turn[9 + j] = turn_weight * (-h / 2 * one + twelfth * (omega1[c] + S0[i][j]));
      of_spin[j] = spin_weight * -sixth * (turn0[c] + 4 * (turn_m[c] / 2 + turns0[c]));
      of_spin[3 + j] =
          spin_weight * (-one - sixth * (omega0[c] + 4 * (h / 8 * turn_m[c] + omega_m[c] / 2 + omegas0[c])));
      of_spin[6 + j] = spin_weight * -sixth * (turn1[c] + 4 * (turn_m[c] / 2 - turns1[c]));
      of_spin[9 + j] =
          spin_weight * (one - sixth * (omega1[c] + 4 * (omega_m[c] / 2 - h / 8 * turn_m[c] - omegas1[c])));
    }
  }
  const double *p0 = nodes->by_p + 3 * m * k, *p1 = p0 + 3 * m, *pm = middles->by_p + 3 * m * k;
  for (long j = 0; j < m; j++, p0 += 3, p1 += 3, pm += 3) {
    const double less[3] = {p0[0] - p1[0], p0[1] - p1[1], p0[2] - p1[2]};
    for (int i = 0; i < 3; i++) {
      const double through = eighth[i] * less[0] + eighth[3 + i] * less[1] + eighth[6 + i] * less[2];
      by[i * m + j] = turn_weight * -twelfth * less[i];
      by[(3 + i) * m + j] = spin_weight * -sixth * (p0[i] + p1[i] + 4 * (pm[i] + through));
    }
  }
}

/* Hermite weights of the end value, the initial rate and the end rate of a cubic that begins at 0 */
typedef struct {
  double there, out, back;
} Hermite;

static Hermite hermite(double s) {
  return (Hermite){s * s * (3 - 2 * s), s * (1 - s) * (1 - s), s * s * (s - 1)};
}

/* rows of one reading; by_turn (2, 3) and by_c (2, harmonics) are column-major */
static void reading_rows(const Record *record, long m, long harmonics, Hermite at, const double *residual,
                         const double *by_turn, const double *by_c, double *r, double *sides, double *by) {
  const double h = record->spacing, weight = 1.0 / record->reading;
  for (int i = 0; i < 2; i++) {
    r[i] = weight * residual[i];
    for (int j = 0; j < 3; j++) {
      const double turn = weight * by_turn[2 * j + i];
      double *side = sides + i * SIDES + j;
      side[0] = (1 - at.there) * turn, side[3] = h * at.out * turn, side[6] = at.there * turn, side[9] = h * at.back * turn;
    }
    for (long j = 0; j < m; j++) by[i * m + j] = j < harmonics ? weight * by_c[2 * j + i] : 0.0;
  }
}

/* add rows to the border of two neighbouring nodes and to the parameters' gradient */
static void couple_parameters(long rows, long m, const double *r, const double *sides, const double *by, double *border,
                              double *gradient) {
  long j = 0;
  for (; j + WIDE <= m; j += WIDE) {
    lane sums[SIDES], down = load(gradient + j);
    for (int c = 0; c < SIDES; c++) sums[c] = load(border + c * m + j);
    for (long row = 0; row < rows; row++) {
      const lane here = load(by + row * m + j);
      down += r[row] * here;
      for (int c = 0; c < SIDES; c++) sums[c] += sides[row * SIDES + c] * here;
    }
    store(gradient + j, down);
    for (int c = 0; c < SIDES; c++) store(border + c * m + j, sums[c]);
  }
  for (; j < m; j++)
    for (long row = 0; row < rows; row++) {
      const double here = by[row * m + j];
      gradient[j] += r[row] * here;
      for (int c = 0; c < SIDES; c++) border[c * m + j] += sides[row * SIDES + c] * here;
    }
}

static void couple_nodes(long rows, const double *r, const double *sides, double *diagonal, double *upper,
                         double *gradient) {
  double sums[SIDES][SIDES] = {{0}}, down[SIDES] = {0};
  for (long row = 0; row < rows; row++, sides += SIDES)
    for (int a = 0; a < SIDES; a++) {
      down[a] += sides[a] * r[row];
      for (int b = 0; b < SIDES; b++) sums[a][b] += sides[a] * sides[b];
    }
  for (int a = 0; a < STATES; a++)
    for (int b = 0; b < STATES; b++) {
      diagonal[STATES * a + b] += sums[a][b];
      diagonal[STATES * (STATES + a) + b] += sums[STATES + a][STATES + b];
      upper[STATES * a + b] += sums[a][STATES + b];
    }
  for (int a = 0; a < SIDES; a++) gradient[a] += down[a];
}

/* Evaluate at rotations R (intervals + 1, 3, 3), spins omega (intervals + 1, 3) and parameters p; returns the sum of
   squares. work: CHUNK columns of the parameter Jacobians of two accelerations and a reading. */
double body_equations(const Model *model, const Record *record, const double *R, const double *omega, const double *p,
                      const Equations *to, double *work) {
  const long m = model->parameters, n = model->harmonics, total = record->intervals;
  Accelerations nodes, middles;
  nodes.by_p = work, middles.by_p = work + 3 * CHUNK * m;
  double *by_c = work + 6 * CHUNK * m;
  for (long begin = 0; begin < total; begin += CHUNK - 1) {
    const long count = total - begin < CHUNK - 1 ? total - begin : CHUNK - 1, end = begin + count;
    Between between[CHUNK];
    double R_mid[CHUNK][9], omega_mid[CHUNK][3];
    accelerate(model, count + 1, R + 9 * begin, omega + 3 * begin, record->node_palms + PALM_INPUTS * begin, p, &nodes);
    memcpy(to->force + 3 * begin, nodes.force, (count + 1) * sizeof nodes.force[0]);
    for (long k = 0; k < count; k++) {
      go_between(record->spacing, R + 9 * (begin + k), omega + 3 * (begin + k), nodes.alpha[k], between + k);
      memcpy(R_mid[k], between[k].R, sizeof R_mid[k]);
      memcpy(omega_mid[k], between[k].omega, sizeof omega_mid[k]);
    }
    accelerate(model, count, R_mid[0], omega_mid[0], record->middle_palms + PALM_INPUTS * begin, p, &middles);
    for (long k = begin; k < end; k++) {
      const long row = OF_STEP * k + 2 * record->first[k];
      step_rows(record, m, omega + 3 * k, between + k - begin, &nodes, &middles, k - begin, to->r + row,
                to->sides + SIDES * row, to->by + m * row);
    }
    for (long from = record->first[begin], k = begin; from < record->first[end]; from += CHUNK) {
      const long left = record->first[end] - from, some = left < CHUNK ? left : CHUNK;
      double there[CHUNK][9], at[CHUNK][9], geometry[CHUNK][GEOMETRY], y[CHUNK][2], by_turn[CHUNK][6];
      long of[CHUNK];
      Hermite weights[CHUNK];
      for (long i = 0; i < some; i++) {
        while (record->first[k + 1] <= from + i) k++;
        const Between *own = between + k - begin;
        const Hermite weight = weights[i] = hermite(record->share[from + i]);
        const double *spin = omega + 3 * k;
        double v[3];
        for (int j = 0; j < 3; j++)
          v[j] = weight.there * own->phi[j] + record->spacing * (weight.out * spin[j] + weight.back * own->ending[j]);
        turned(v, R + 9 * k, there[i]);
        of[i] = k;
      }
      lay_out_by_columns(at, there[0], some);
      lay_out(geometry[0], record->geometry + GEOMETRY * from, some, GEOMETRY);
      const double *in[] = {at[0], geometry[0], p};
      double *out[] = {y[0], by_turn[0], by_c};
      model->reading(in, out, columns_of(some));
      for (long i = 0; i < some; i++) {
        const long which = from + i, row = OF_STEP * (of[i] + 1) + 2 * which;
        double *residual = to->residual + 2 * which;
        for (int j = 0; j < 2; j++) residual[j] = y[i][j] - record->value[2 * which + j];
        reading_rows(record, m, n, weights[i], residual, by_turn[i], by_c + 2 * n * i, to->r + row,
                     to->sides + SIDES * row, to->by + m * row);
      }
    }
    for (long k = begin; k < end; k++) {
      const long row = OF_STEP * k + 2 * record->first[k], rows = OF_STEP + 2 * (record->first[k + 1] - record->first[k]);
      const double *r = to->r + row, *sides = to->sides + SIDES * row;
      couple_nodes(rows, r, sides, to->diagonal + STATES * STATES * k, to->upper + STATES * STATES * k,
                   to->nodes_gradient + STATES * k);
      couple_parameters(rows, m, r, sides, to->by + m * row, to->border + STATES * m * k, to->gradient);
    }
  }
  double sum = 0.0;
  for (long row = 0; row < OF_STEP * total + 2 * record->first[total]; row++) sum += to->r[row] * to->r[row];
  return sum;
}
