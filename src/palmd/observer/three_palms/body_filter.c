/* Extended Kalman filter of one body between three palms: steps, corrections and outputs;
   `observer.three_palms.body_filter` documents it. Arrays belong to the caller; no state is kept. Covariances stay
   exactly symmetric. Kernels, whose matrices are column-major, are passed by address. */

#include <math.h>
#include <string.h>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3") /* vectorises loops; does not reorder sums */
#endif

#include "turns.h"

#define STATES 6
#define PALM_INPUTS 36
#define RIG_INPUTS 2
#define GEOMETRY 24
#define OUTPUTS 10 /* numbers: two of each of three contacts; four of two readings of the centre of mass */
#define MOST 256 /* states and parameters */
#define LEAST_S 1e-9 /* shorter spans are ignored */
#ifdef __AVX512F__
#define WIDE 8 /* numbers in a register */
#else
#define WIDE 4
#endif
#define BLOCK (2 * WIDE) /* columns whose sums stay in registers */

enum { ANGLE = 0, RATE = 3, ACCELERATION = 6, JOINTS = 9 };                /* offsets in a report of the joints */
enum { NORMAL = 0, NORMAL_RATE = 9, NORMAL_ACCELERATION = 18, SPIN = 27 }; /* offsets in the palms, three vectors each */

const long body_filter_sizes[] = {STATES, PALM_INPUTS, RIG_INPUTS, GEOMETRY, OUTPUTS, MOST, JOINTS};

typedef void Kernel(const double *const *in, double *const *out, long columns);

typedef struct {
  Kernel *acceleration, *reading;
  long parameters, harmonics;
  double rig[RIG_INPUTS], gate, nis_gain; /* gate of a reading's NIS; weight of a reading in the mean NIS */
  double turn, spin, by_spin;            /* spectral densities of the process noise */
} Model;

typedef struct {
  double R[3][3], omega[3], nis, p[];
} Body;

typedef struct {
  const double *t, (*reports)[JOINTS];
  long count;
  double longest; /* extrapolation limit beyond the nearest report (s) */
} Track;

typedef struct {
  double t, a, b, pad; /* s, m, m, 0 to 2 */
} Reading;

/* see `JointTrack.at` */
void joints_at(const Track *track, double t, double *joints) {
  long low = 0, high = track->count;
  while (low < high) {
    const long middle = (low + high) / 2;
    if (track->t[middle] < t) low = middle + 1;
    else high = middle;
  }
  const long before = low > 0 ? low - 1 : 0, after = low < track->count ? low : track->count - 1;
  const long which = t - track->t[before] < track->t[after] - t ? before : after;
  const double dt = fmax(-track->longest, fmin(track->longest, t - track->t[which])), *report = track->reports[which];
  for (int j = 0; j < 3; j++) {
    joints[ANGLE + j] = report[ANGLE + j] + dt * report[RATE + j] + dt * dt / 2 * report[ACCELERATION + j];
    joints[RATE + j] = report[RATE + j] + dt * report[ACCELERATION + j];
    joints[ACCELERATION + j] = report[ACCELERATION + j];
  }
}

/* see `system.three_palms.palms_at`; axes: a and b of each pad */
static void palms_at(const double *joints, double *palms, double axes[3][2][3]) {
  static const double TURNS[3] = {0.0, 1.0, -1.0};
  const double *angle = joints + ANGLE, *rate = joints + RATE, *acceleration = joints + ACCELERATION;
  const double up[3] = {0.0, cos(angle[0]), sin(angle[0])}, n1[3] = {0.0, -up[2], up[1]};
  double tilted[3], (*normal)[3] = (double(*)[3])(palms + NORMAL);
  for (int i = 0; i < 3; i++) {
    const double cosine = cos(angle[i]), sine = sin(angle[i]), side = TURNS[i];
    for (int k = 0; k < 3; k++) {
      const double edge = k == 0;
      normal[i][k] = i == 0 ? n1[k] : side * cosine * edge + sine * up[k];
      axes[i][0][k] = i == 0 ? edge : -side * sine * edge + cosine * up[k];
      axes[i][1][k] = i == 0 ? up[k] : n1[k];
    }
  }
  const double tilt[3] = {rate[0], 0.0, 0.0};
  cross(tilt, n1, tilted);
  for (int i = 0; i < 3; i++) {
    double *spin = palms + SPIN + 3 * i, *moving = palms + NORMAL_RATE + 3 * i, spin_rate[3], first[3], second[3];
    for (int k = 0; k < 3; k++) {
      spin[k] = tilt[k] + TURNS[i] * rate[i] * n1[k];
      spin_rate[k] = (k == 0) * acceleration[0] + TURNS[i] * (acceleration[i] * n1[k] + rate[i] * tilted[k]);
    }
    cross(spin, normal[i], moving);
    cross(spin_rate, normal[i], first);
    cross(spin, moving, second);
    for (int k = 0; k < 3; k++) palms[NORMAL_ACCELERATION + 3 * i + k] = first[k] + second[k];
  }
}

/* see `kernels.reading_geometry`; of one reading of `pad` */
static void geometry_of(const double *palms, double axes[3][2][3], int pad, double *geometry) {
  const double *one = palms + 3 * pad, *two = palms + 3 * ((pad + 1) % 3), *three = palms + 3 * ((pad + 2) % 3);
  double *reciprocal = geometry + 9;
  cross(two, three, reciprocal);
  cross(three, one, reciprocal + 3);
  cross(one, two, reciprocal + 6);
  const double volume = one[0] * reciprocal[0] + one[1] * reciprocal[1] + one[2] * reciprocal[2];
  for (int k = 0; k < 9; k++) reciprocal[k] /= volume;
  memcpy(geometry, one, 3 * sizeof *one);
  memcpy(geometry + 3, two, 3 * sizeof *one);
  memcpy(geometry + 6, three, 3 * sizeof *one);
  memcpy(geometry + 18, axes[pad], 6 * sizeof *one);
}

static void by_columns(const double R[3][3], double *out) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) out[3 * j + i] = R[i][j];
}

/* R <- exp[v]R */
static void turn(double R[3][3], const double *v) {
  double after[3][3];
  turned(v, R[0], after[0]);
  memcpy(R, after, sizeof after);
}

/* M <- A^-1; overwrites A */
static void inverted(double A[STATES][STATES], double M[STATES][STATES]) {
  for (int i = 0; i < STATES; i++)
    for (int j = 0; j < STATES; j++) M[i][j] = i == j;
  for (int k = 0; k < STATES; k++) {
    int best = k;
    for (int i = k + 1; i < STATES; i++)
      if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
    for (int j = 0; j < STATES; j++) {
      const double a = A[k][j], m = M[k][j];
      A[k][j] = A[best][j], A[best][j] = a;
      M[k][j] = M[best][j], M[best][j] = m;
    }
    const double pivot = 1.0 / A[k][k];
    for (int j = 0; j < STATES; j++) A[k][j] *= pivot, M[k][j] *= pivot;
    for (int i = 0; i < STATES; i++) {
      if (i == k) continue;
      const double share = A[i][k];
      for (int j = 0; j < STATES; j++) A[i][j] -= share * A[k][j], M[i][j] -= share * M[k][j];
    }
  }
}

static void add(double *to, double share, const double *row, long n) {
  for (long j = 0; j < n; j++) to[j] += share * row[j];
}

typedef double wide __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));

/* to[i][j] <- sum over k < rows, in this order, of shares[count * k + i] * P[k][j]; n >= BLOCK columns */
static inline __attribute__((always_inline)) void gathered(double (*to)[MOST], const int count, const double *shares,
                                                           const double *P, long rows, long n) {
  for (long from = 0; from < n; from += BLOCK) {
    const long j = from < n - BLOCK ? from : n - BLOCK;
    wide left[3] = {{0}}, right[3] = {{0}};
    for (long k = 0; k < rows; k++) {
      const wide *row = (const wide *)(P + k * n + j);
      for (int i = 0; i < count; i++) {
        left[i] += shares[count * k + i] * row[0];
        right[i] += shares[count * k + i] * row[1];
      }
    }
    for (int i = 0; i < count; i++) {
      wide *sums = (wide *)(to[i] + j);
      sums[0] = left[i], sums[1] = right[i];
    }
  }
}

/* propagate by h (s); palms: PALM_INPUTS in the middle of the step */
static void step(const Model *model, Body *body, double *P, double h, const double *palms) {
  const long m = model->parameters, n = STATES + m;
  double R[9], alpha[3], force[3], by_turn[9], by_omega[9], by_p[3 * MOST];
  by_columns(body->R, R);
  const double *in[] = {R, body->omega, palms, body->p, model->rig};
  double *out[] = {alpha, force, by_turn, by_omega, by_p};
  model->acceleration(in, out, 1);

  const double *w = body->omega;
  double J[STATES][STATES] = {{0, -w[2], w[1], 1, 0, 0}, {w[2], 0, -w[0], 0, 1, 0}, {-w[1], w[0], 0, 0, 0, 1}};
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) J[3 + i][j] = by_turn[3 * j + i], J[3 + i][3 + j] = by_omega[3 * j + i];
  double A[STATES][STATES], B[STATES][STATES], M[STATES][STATES], onward[STATES][STATES], rate[STATES];
  for (int i = 0; i < STATES; i++)
    for (int j = 0; j < STATES; j++) A[i][j] = (i == j) - h / 2 * J[i][j], B[i][j] = (i == j) + h / 2 * J[i][j];
  inverted(A, M);
  const double f[STATES] = {w[0], w[1], w[2], alpha[0], alpha[1], alpha[2]};
  for (int i = 0; i < STATES; i++) {
    rate[i] = 0.0;
    for (int k = 0; k < STATES; k++) rate[i] += h * M[i][k] * f[k];
    for (int j = 0; j < STATES; j++) {
      onward[i][j] = 0.0;
      for (int k = 0; k < STATES; k++) onward[i][j] += M[i][k] * B[k][j];
    }
  }
  const double noise = h * (model->spin + model->by_spin * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]));
  turn(body->R, rate);
  for (int i = 0; i < 3; i++) body->omega[i] += rate[3 + i];

  double by[3][MOST], T[STATES][MOST] = {{0}};
  gathered(by, 3, by_p, P + STATES * n, m, n);
  for (int i = 0; i < STATES; i++) {
    for (int k = 0; k < STATES; k++) add(T[i], onward[i][k], P + k * n, n);
    for (int k = 0; k < 3; k++) add(T[i], h * M[i][3 + k], by[k], n);
  }
  double onto[STATES][3] = {{0}};
  for (int i = 0; i < STATES; i++)
    for (long k = 0; k < m; k++)
      for (int j = 0; j < 3; j++) onto[i][j] += T[i][STATES + k] * by_p[3 * k + j];
  for (int i = 0; i < STATES; i++) {
    memcpy(P + i * n + STATES, T[i] + STATES, m * sizeof *P);
    for (long k = 0; k < m; k++) P[(STATES + k) * n + i] = T[i][STATES + k];
    for (int j = 0; j <= i; j++) {
      double sum = i == j ? (i < 3 ? h * model->turn : noise) : 0.0;
      for (int k = 0; k < STATES; k++) sum += T[i][k] * onward[j][k];
      for (int k = 0; k < 3; k++) sum += onto[i][k] * h * M[j][3 + k];
      P[i * n + j] = P[j * n + i] = sum;
    }
  }
}

/* a predicted reading y (2), its Jacobian H, column-major up to the harmonics (zero for the spin), and HP (2, n) */
typedef struct {
  double y[2], H[2 * MOST], HP[2][MOST];
} Prediction;

static void predict(const Model *model, const Body *body, const double *P, const double *geometry, Prediction *at) {
  const long n = STATES + model->parameters;
  double R[9];
  by_columns(body->R, R);
  const double *in[] = {R, geometry, body->p};
  double *out[] = {at->y, at->H, at->H + 2 * STATES};
  model->reading(in, out, 1);
  memset(at->H + STATES, 0, STATES * sizeof *P);
  gathered(at->HP, 2, at->H, P, STATES + model->harmonics, n);
}

/* row times the transpose of row i of H */
static double across(const Model *model, const double *row, const Prediction *at, int i) {
  double sum = 0.0;
  for (long k = 0; k < STATES + model->harmonics; k++) sum += row[k] * at->H[2 * k + i];
  return sum;
}

/* update with a reading (a, b) (m) of this variance (m²); square-root form of the 2 x 2 innovation covariance */
static void correct(const Model *model, Body *body, double *P, const double *geometry, double a, double b,
                    double variance) {
  const long n = STATES + model->parameters;
  Prediction at;
  predict(model, body, P, geometry, &at);
  const double lower = sqrt(across(model, at.HP[0], &at, 0) + variance);
  const double side = across(model, at.HP[1], &at, 0) / lower;
  const double last = sqrt(across(model, at.HP[1], &at, 1) + variance - side * side);
  const double first = (a - at.y[0]) / lower, second = (b - at.y[1] - side * first) / last;
  const double nis = (first * first + second * second) / 2;
  body->nis += (fmin(nis, model->gate) - body->nis) * model->nis_gain;
  if (nis > model->gate) return;
  double W[2][MOST], move[MOST];
  for (long j = 0; j < n; j++) {
    W[0][j] = at.HP[0][j] / lower;
    W[1][j] = (at.HP[1][j] - side * W[0][j]) / last;
    move[j] = W[0][j] * first + W[1][j] * second;
  }
  for (long i = 0; i < n; i++) {
    const double one = W[0][i], two = W[1][i];
    double *row = P + i * n;
    for (long j = 0; j < n; j++) row[j] -= one * W[0][j] + two * W[1][j];
  }
  turn(body->R, move);
  for (int i = 0; i < 3; i++) body->omega[i] += move[3 + i];
  for (long k = 0; k < model->parameters; k++) body->p[k] += move[STATES + k];
}

/* propagate from t to `until` (s) in steps of at most `longest` (s), and fuse `count` readings of this variance (m²);
   returns the time reached (s) */
double body_carry(const Model *model, const Track *track, Body *body, double *P, double t, const Reading *readings,
                  long count, double variance, double until, double longest) {
  double joints[JOINTS], palms[PALM_INPUTS], axes[3][2][3], geometry[GEOMETRY];
  for (long k = 0; k <= count; k++) {
    const double end = k < count ? readings[k].t : until, start = t, span = end - start;
    if (span > LEAST_S) {
      const long steps = (long)ceil(span / longest);
      const double h = span / steps;
      for (long i = 0; i < steps; i++) {
        joints_at(track, start + (i + 0.5) * h, joints);
        palms_at(joints, palms, axes);
        step(model, body, P, h, palms);
        t += h;
      }
    }
    if (k == count) break;
    joints_at(track, end, joints);
    palms_at(joints, palms, axes);
    geometry_of(palms, axes, (int)readings[k].pad, geometry);
    correct(model, body, P, geometry, readings[k].a, readings[k].b, variance);
  }
  return t;
}

/* outputs at t (s): y (OUTPUTS) and its covariance (OUTPUTS, OUTPUTS), contacts palm by palm, then the centre of mass,
   which is a contact read along axes scaled by `shrunk`; the palms (PALM_INPUTS), their normal forces per unit mass */
void body_seen(const Model *model, const Track *track, const Body *body, const double *P, double t, double shrunk,
               double *y, double *covariance, double *palms, double *force) {
  double joints[JOINTS], axes[3][2][3], geometry[GEOMETRY];
  joints_at(track, t, joints);
  palms_at(joints, palms, axes);
  Prediction at[OUTPUTS / 2];
  for (int g = 0; g < OUTPUTS / 2; g++) {
    geometry_of(palms, axes, g < 3 ? g : 0, geometry);
    if (g >= 3) {
      for (int k = 9; k < 18; k++) geometry[k] /= shrunk;
      for (int k = 0; k < 6; k++) geometry[18 + k] = shrunk * (g == 3 ? k == 0 || k == 4 : k == 2);
    }
    predict(model, body, P, geometry, &at[g]);
    y[2 * g] = at[g].y[0], y[2 * g + 1] = at[g].y[1];
  }
  for (int i = 0; i < OUTPUTS; i++)
    for (int j = 0; j <= i; j++)
      covariance[i * OUTPUTS + j] = covariance[j * OUTPUTS + i] =
          across(model, at[i / 2].HP[i % 2], &at[j / 2], j % 2);
  double R[9], alpha[3], by_turn[9], by_omega[9], by_p[3 * MOST];
  by_columns(body->R, R);
  const double *in[] = {R, body->omega, palms, body->p, model->rig};
  double *out[] = {alpha, force, by_turn, by_omega, by_p};
  model->acceleration(in, out, 1);
}
