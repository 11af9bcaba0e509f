/* The computations of a bank of shape maps between two decisions: the palms' motion, readings corrected for the rig's
   errors, prediction, update, gates and scores, and late events fused in the order of their times.

   `observer.palms`, `observer.rig_error`, `observer.bank` and `observer.history` document what is computed, and why;
   `observer.compiled_fusion` must use the sizes below. Arrays belong to the caller; nothing is kept here. Kernels are
   passed by address, so that one file serves banks of any size and order. */

#include <math.h>
#include <string.h>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3") /* vectorised loops; the order of sums does not change */
#endif

#define JOINTS 2
#define MOTION (3 * JOINTS) /* angles, rates, accelerations */
#define RIG_INPUTS 15
#define FRICTION_INPUT 4
#define VIBRATION_ERROR_INPUTS 11 /* errors of kappa, of the transmission, of the period, of friction's lever arm */
#define VIBRATION_ERRORS 4
#define NAMED 18
#define MOST_STATES 64
#define EVENTS 24 /* most events that can be undone */
#define RADIUS 6  /* index of the mean radius in the states; the other coefficients of the outline follow */
enum { ZERO = 0, SCALE = 2, SAGITTA = 4, LAG = 6, STANDOFF = 8, TILT = 10, TURN = 11, FRICTION = 12, FORCE = 13, KAPPA = 15, CONSTANTS = 19 };

const long fusion_sizes[] = {JOINTS,  RIG_INPUTS, FRICTION_INPUT, VIBRATION_ERROR_INPUTS, NAMED, MOST_STATES, EVENTS,
                             RADIUS,  ZERO,       SCALE,          SAGITTA,              LAG,   STANDOFF,    TILT,
                             TURN,    FRICTION,   FORCE,          KAPPA,                CONSTANTS};

typedef void Kernel(const double *const *in, double *const *out, long columns);

/* ---- the palms' motion: `observer.palms` */

typedef struct {
  double state[JOINTS][3], P[3][3], jerk[JOINTS]; /* (φ, ω, α) of each joint; one covariance for all joints */
  double t, moved, liveliest;                     /* last report, -inf before the first; last motion; decaying max. jerk */
  double plan_t, plan[JOINTS];                    /* accelerations of the last report, NaN if it had none */
  double variance;                                /* of a reported angle */
} Palms;

typedef struct { /* values that are not reported are NaN */
  double t, angles[JOINTS], rates[JOINTS], accelerations[JOINTS];
} Report;

static const double JERK = 200.0, PLANNED_JERK = 1.0, PLAN_RATE_SD = 2e-3, PLAN_ACCELERATION_SD = 2e-2;
static const double ROUNDING_S2 = 6e-5, CHANGED = 0.2, JERK_MEMORY_S = 1.0, FORGOTTEN_S = 0.5;
static const double FIRST_RATE_SD = 0.5, FIRST_ACCELERATION_SD = 5.0, RESTING_RAD_S = 2e-3, SHARED_AFTER_S = 1.0;

void palms_at(const Palms *palms, double t, double *motion) {
  const double dt = t - palms->t, half = dt * dt / 2, sixth = half * dt / 3;
  for (int j = 0; j < JOINTS; j++) {
    const double *s = palms->state[j], jerk = palms->jerk[j];
    motion[j] = s[0] + dt * s[1] + half * s[2] + sixth * jerk;
    motion[JOINTS + j] = s[1] + dt * s[2] + half * jerk;
    motion[2 * JOINTS + j] = s[2] + dt * jerk;
  }
}

/* variances of angles and rates at time t */
void palms_variance(const Palms *palms, double t, double *angles, double *rates) {
  const double age = t - palms->t, turned = CHANGED * palms->liveliest;
  const double phi = turned * (age * age * age) / 6, omega = turned * (age * age) / 2;
  for (int j = 0; j < JOINTS; j++) {
    const double late = ROUNDING_S2 * palms->state[j][2], later = ROUNDING_S2 * palms->jerk[j];
    angles[j] = palms->P[0][0] + late * late + phi * phi;
    rates[j] = palms->P[1][1] + later * later + omega * omega;
  }
}

/* how many readings share the error of one place on the pad */
static double repetitions(const Palms *palms) {
  return palms->t == -INFINITY ? 1.0 : 1.0 + (palms->t - palms->moved) / SHARED_AFTER_S;
}

static void palms_begin(Palms *palms, const Report *report) {
  const int rates = !isnan(report->rates[0]), accelerations = !isnan(report->accelerations[0]);
  const double rate_sd = rates ? PLAN_RATE_SD : FIRST_RATE_SD;
  const double acceleration_sd = accelerations ? PLAN_ACCELERATION_SD : FIRST_ACCELERATION_SD;
  palms->t = palms->moved = report->t;
  memset(palms->P, 0, sizeof palms->P);
  palms->P[0][0] = palms->variance;
  palms->P[1][1] = rate_sd * rate_sd;
  palms->P[2][2] = acceleration_sd * acceleration_sd;
  palms->plan_t = accelerations ? report->t : NAN;
  palms->liveliest = 0.0;
  for (int j = 0; j < JOINTS; j++) {
    palms->state[j][0] = report->angles[j];
    palms->state[j][1] = rates ? report->rates[j] : 0.0;
    palms->state[j][2] = accelerations ? report->accelerations[j] : 0.0;
    palms->plan[j] = report->accelerations[j];
    palms->jerk[j] = 0.0;
  }
}

static void palms_fuse(Palms *palms, int which, const double *values, double variance) {
  double gain[3], row[3];
  const double spread = palms->P[which][which] + variance;
  for (int i = 0; i < 3; i++) {
    gain[i] = palms->P[i][which] / spread;
    row[i] = palms->P[which][i];
  }
  for (int j = 0; j < JOINTS; j++) {
    const double miss = values[j] - palms->state[j][which];
    for (int i = 0; i < 3; i++) palms->state[j][i] += miss * gain[i];
  }
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) palms->P[i][k] += gain[i] * gain[k] * spread - gain[i] * row[k] - row[i] * gain[k];
}

void palms_feed(Palms *palms, const Report *report) {
  const double dt = report->t - palms->t;
  if (!(dt <= FORGOTTEN_S)) { /* true for the first report as well: t is -inf before it */
    palms_begin(palms, report);
    return;
  }
  if (dt < 0) return;
  const int accelerations = !isnan(report->accelerations[0]);
  double now[MOTION], fastest = 0.0, jerk = accelerations ? PLANNED_JERK : JERK, F[3][3] = {{1, dt, dt * dt / 2}, {0, 1, dt}, {0, 0, 1}};
  palms_at(palms, report->t, now);
  for (int j = 0; j < JOINTS; j++)
    for (int i = 0; i < 3; i++) palms->state[j][i] = now[i * JOINTS + j];
  const double d2 = dt * dt, d3 = d2 * dt, d4 = d2 * d2, d5 = d4 * dt;
  const double white[3][3] = {{d5 / 20, d4 / 8, d3 / 6}, {d4 / 8, d3 / 3, d2 / 2}, {d3 / 6, d2 / 2, dt}};
  double left[3][3], P[3][3];
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) {
      left[i][k] = 0.0;
      for (int m = 0; m < 3; m++) left[i][k] += F[i][m] * palms->P[m][k];
    }
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) {
      P[i][k] = 0.0;
      for (int m = 0; m < 3; m++) P[i][k] += left[i][m] * F[k][m];
      P[i][k] = P[i][k] + white[i][k] * (jerk * jerk) + (i == k && i ? 1e-8 : 0.0) * dt;
    }
  memcpy(palms->P, P, sizeof P);
  palms->t = report->t;
  for (int j = 0; j < JOINTS; j++) fastest = fmax(fastest, fabs(palms->jerk[j]));
  palms->liveliest = fmax(fastest, palms->liveliest * exp(-dt / JERK_MEMORY_S));
  palms_fuse(palms, 0, report->angles, palms->variance);
  if (!isnan(report->rates[0])) palms_fuse(palms, 1, report->rates, PLAN_RATE_SD * PLAN_RATE_SD);
  if (accelerations) palms_fuse(palms, 2, report->accelerations, PLAN_ACCELERATION_SD * PLAN_ACCELERATION_SD);
  const double since = report->t - palms->plan_t;
  for (int j = 0; j < JOINTS; j++) {
    if (!accelerations) palms->jerk[j] = 0.0;
    else if (since > 0) palms->jerk[j] = (report->accelerations[j] - palms->plan[j]) / since;
    palms->plan[j] = report->accelerations[j];
    if (fabs(palms->state[j][1]) > RESTING_RAD_S) palms->moved = report->t;
  }
  palms->plan_t = accelerations ? report->t : NAN;
}

/* ---- errors of the rig's constants: `observer.rig_error` */

typedef struct {
  const double *values, *lengths, *curvatures; /* CONSTANTS, JOINTS, JOINTS */
  double *s, *most;                            /* of each pad: last contact, corrected (m); largest force measured (N) */
} RigError;

typedef struct {
  double t, s, force;
  long pad;
} Reading;

static const double LEAST_CURVATURE_MARGIN = 0.05;

/* slopes that bowed surfaces add to φ1 and φ2 at the last contacts; `every`: stride of `values` */
static void bows(const RigError *rig, const double *values, long every, double *more) {
  double slopes[JOINTS];
  for (int i = 0; i < JOINTS; i++)
    slopes[i] = 4.0 * values[(SAGITTA + i) * every] / rig->lengths[i] * (1.0 - 2.0 * (rig->s[i] / rig->lengths[i]));
  more[0] = slopes[0];
  more[1] = -slopes[0] - slopes[1];
}

static void surfaces_at(const Palms *palms, const RigError *rig, double t, double *motion) {
  double more[JOINTS];
  bows(rig, rig->values, 1, more);
  palms_at(palms, t, motion);
  motion[0] += rig->values[TILT] + more[0];
  motion[1] += rig->values[TURN] + more[1];
}

/* the force (N) that a reading was taken under; a NaN means that the pad is saturated: the largest force so far */
static double pressing(const RigError *rig, long pad, double force) {
  double *most = &rig->most[pad - 1];
  if (isnan(force)) return *most;
  if (force > *most) *most = force;
  return force;
}

/* derivatives of the contact's distance from the hinge on palm `i` by the heights of both surfaces */
static void lifts(const RigError *rig, int i, double opening, double radius, double *by) {
  double margin = 1.0;
  if (rig->curvatures[0] != 0.0 || rig->curvatures[1] != 0.0) {
    opening -= rig->curvatures[0] * rig->s[0] + rig->curvatures[1] * rig->s[1];
    margin = fmax(1.0 - rig->curvatures[i] * radius, LEAST_CURVATURE_MARGIN);
  }
  by[i] = cos(opening) / sin(opening) / margin;
  by[1 - i] = 1.0 / sin(opening) / margin;
}

/* height of palm `k`'s surface above the hinge line at its last contact; `every`: stride of `values` */
static double height(const RigError *rig, int k, const double *values, long every) {
  const double u = rig->s[k] / rig->lengths[k];
  return values[(STANDOFF + k) * every] + 4.0 * values[(SAGITTA + k) * every] * (u * u);
}

static double corrected(const RigError *rig, const Reading *reading, double opening, double radius) {
  const double *v = rig->values;
  const int i = (int)reading->pad - 1;
  double by[JOINTS];
  rig->s[i] = (reading->s - v[ZERO + i] - v[FORCE + i] * reading->force) / (1.0 + v[SCALE + i]);
  lifts(rig, i, opening, radius, by);
  return rig->s[i] - by[0] * height(rig, 0, v, 1) - by[1] * height(rig, 1, v, 1);
}

/* ---- the bank: `observer.bank`, `observer.filters.shape_map` */

typedef struct {
  Kernel *predict, *update[JOINTS], *values, *predict_one, *named;
  double *x[2], *P[2], *score, *nis, *outcome; /* double buffers: kernels write to the other side, which becomes current */
  double *y;                                   /* NAMED of each filter, from the last `disagreement` */
  double *rig;                                 /* RIG_INPUTS */
  long *now;                                   /* current side, number of active blocks */
  long n, block;
  double memory_s;
} Bank;

static const double GATE = 16.0, NIS_READINGS = 50.0, UNEXPECTED_NIS = 1.4, LONGEST_STEP_S = 0.0061;

static long size_of(const Bank *bank) { return bank->now[1] * bank->block; }

static long best_of(const Bank *bank) {
  long best = 0;
  for (long i = 1; i < size_of(bank); i++)
    if (bank->score[i] > bank->score[best]) best = i;
  return best;
}

static void friction_of(const Bank *bank, const RigError *rig) {
  bank->rig[FRICTION_INPUT] = rig->values[FRICTION];
  for (int i = 0; i < VIBRATION_ERRORS; i++) bank->rig[VIBRATION_ERROR_INPUTS + i] = rig->values[KAPPA + i];
}

static void prediction_inputs(const Bank *bank, const Palms *palms, const RigError *rig, double t, double dt, double *u) {
  u[0] = dt;
  surfaces_at(palms, rig, t, u + 1);
  for (int j = 0; j < JOINTS; j++) u[1 + MOTION + j] = palms->jerk[j];
  friction_of(bank, rig);
  memcpy(u + 1 + MOTION + JOINTS, bank->rig, RIG_INPUTS * sizeof *u);
}

/* propagate the bank from `t` to `until`, in equal steps; its scores decay */
void carry(Bank *bank, const Palms *palms, const RigError *rig, double t, double until, double repeated) {
  const double gap = until - t, steps = fmax(1.0, ceil(gap / LONGEST_STEP_S));
  double u[1 + MOTION + JOINTS + RIG_INPUTS];
  for (double done = 0; done < steps; done++) {
    const long side = bank->now[0];
    prediction_inputs(bank, palms, rig, t, gap / steps, u);
    const double *in[] = {bank->x[side], bank->P[side], u};
    double *out[] = {bank->x[1 - side], bank->P[1 - side]};
    bank->predict(in, out, size_of(bank));
    bank->now[0] = 1 - side;
    t += gap / steps;
  }
  const double kept = exp(-(gap / repeated) / bank->memory_s);
  for (long i = 0; i < size_of(bank); i++) bank->score[i] *= kept;
}

/* deactivate filters whose state is not finite, and give them a finite state */
static void park(Bank *bank) {
  const long n = bank->n, size = size_of(bank);
  double *x = bank->x[bank->now[0]], *P = bank->P[bank->now[0]], *outcome = bank->outcome, all = 0.0;
  long successor = -1;
  for (long i = 0; i < n * size; i++) all += x[i];
  for (long i = 0; i < 2 * size; i++) all += outcome[i];
  if (isfinite(all)) return;
  char finite[size];
  for (long f = 0; f < size; f++) {
    double sum = outcome[2 * f] + outcome[2 * f + 1];
    for (long i = 0; i < n; i++) sum += x[f * n + i];
    finite[f] = isfinite(sum);
    if (finite[f] && (successor < 0 || bank->score[f] > bank->score[successor])) successor = f;
  }
  for (long f = 0; f < size; f++) {
    if (finite[f]) continue;
    if (successor >= 0) {
      memcpy(x + f * n, x + successor * n, n * sizeof *x);
      memcpy(P + f * n * n, P + successor * n * n, n * n * sizeof *P);
    } else {
      memset(x + f * n, 0, n * sizeof *x);
      memset(P + f * n * n, 0, n * n * sizeof *P);
      for (long i = 0; i < n; i++) P[f * n * n + i * (n + 1)] = 1.0;
    }
    outcome[2 * f] = outcome[2 * f + 1] = 0.0;
    bank->score[f] = -INFINITY;
  }
}

/* fuse one reading of a pad into every filter; it is one of `repeated` readings that share one error */
void read_pad(Bank *bank, const Palms *palms, const RigError *rig, const Reading *reading, double variance, double repeated) {
  const long side = bank->now[0];
  double motion[MOTION];
  surfaces_at(palms, rig, reading->t, motion);
  const double s = corrected(rig, reading, motion[1], bank->x[side][RADIUS]);
  const double z[] = {s, variance, GATE, repeated, motion[0], motion[1], rig->curvatures[0], rig->curvatures[1]};
  const double *in[] = {bank->x[side], bank->P[side], z};
  double *out[] = {bank->x[1 - side], bank->P[1 - side], bank->outcome};
  bank->update[reading->pad - 1](in, out, size_of(bank));
  bank->now[0] = 1 - side;
  park(bank);
  for (long f = 0; f < size_of(bank); f++) {
    const double nis = bank->outcome[2 * f + 1];
    bank->score[f] += bank->outcome[2 * f];
    bank->nis[f] += ((nis < GATE ? nis : GATE) - bank->nis[f]) / NIS_READINGS; /* bounded: one outlier does not mean a wrong model */
  }
}

typedef struct { /* a reading of `pad`: distance and force, NaN if not measured; a report of the palms if `pad` is 0 */
  double pad, t;
  union {
    struct {
      double s, force;
    };
    struct {
      double angles[JOINTS], rates[JOINTS], accelerations[JOINTS];
    };
  };
} Event;

/* Fuse events in order of time, from `t` on, into a bank that was initialised by a smoother: `observer.filter_catchup`.
   Returns the number of readings not earlier than `t`, which is set to the time of the last of them. */
long follow(Bank *bank, Palms *palms, const RigError *rig, const Event *events, long count, const double *variances, const double *shared, double *t) {
  long read = 0;
  for (const Event *event = events; event < events + count; event++) {
    if (event->pad == 0.0) {
      Report report = {.t = event->t};
      memcpy(report.angles, event->angles, sizeof report - sizeof report.t);
      palms_feed(palms, &report);
      continue;
    }
    const long pad = (long)event->pad;
    const double now = event->t - rig->values[LAG + pad - 1];
    if (now < *t) continue;
    const Reading reading = {now, event->s, pressing(rig, pad, event->force), pad};
    carry(bank, palms, rig, *t, now, INFINITY);
    *t = now;
    read_pad(bank, palms, rig, &reading, variances[pad - 1], fmax(repetitions(palms), shared[pad - 1]));
    read++;
  }
  return read;
}

/* inflate the covariances of one block's filters by `fraction`, but keep the priors, `mean` and `variance` (filters, n),
   of the states from `first` up to `last` */
void fade(Bank *bank, long block, double fraction, long first, long last, const double *mean, const double *variance) {
  const long n = bank->n;
  for (long f = block * bank->block; f < (block + 1) * bank->block; f++) {
    double *x = bank->x[bank->now[0]] + f * n, *P = bank->P[bank->now[0]] + f * n * n, gain[MOST_STATES], shed[MOST_STATES];
    for (long i = 0; i < n * n; i++) P[i] *= 1.0 + fraction;
    for (long state = first; state < last; state++) {
      const double miss = mean[f * n + state] - x[state];
      const double spread = P[state * n + state] + variance[f * n + state] / fraction;
      for (long i = 0; i < n; i++) gain[i] = P[i * n + state] / spread;
      for (long i = 0; i < n; i++) shed[i] = gain[i] * spread;
      for (long i = 0; i < n; i++) x[i] += gain[i] * miss;
      for (long i = 0; i < n; i++)
        for (long j = 0; j < n; j++) P[i * n + j] -= gain[i] * shed[j];
    }
  }
}

/* the mean of a standard normal variable given that it exceeds `a` ≥ 0 */
static double mills(double a) {
  if (a > 20.0) return a + 1.0 / a - 2.0 / (a * a * a);
  return exp(-a * a / 2) / (sqrt(M_PI / 2) * erfc(a / sqrt(2.0)));
}

/* the row with the smallest row·x, and that value; NULL if none is negative */
static const double *hollow(const double *x, long n, const double *rows, long count, double *lowest) {
  const double *row = NULL;
  *lowest = 0.0;
  for (long r = 0; r < count; r++) {
    double value = 0.0;
    for (long i = 0; i < n; i++) value += rows[r * n + i] * x[i];
    if (value < *lowest) *lowest = value, row = rows + r * n;
  }
  return row;
}

/* true if any component of rows·x of one filter is negative */
long falls_below(const Bank *bank, long member, const double *rows, long count) {
  double lowest;
  return hollow(bank->x[bank->now[0]] + member * bank->n, bank->n, rows, count, &lowest) != NULL;
}

/* condition the filters of one block on rows·x ≥ 0 at the smallest component; returns how many violated it */
long lift(Bank *bank, long block, const double *rows, long count) {
  const long n = bank->n;
  long conditioned = 0;
  for (long f = block * bank->block; f < (block + 1) * bank->block; f++) {
    double *x = bank->x[bank->now[0]] + f * n, *P = bank->P[bank->now[0]] + f * n * n, Ph[MOST_STATES];
    double lowest, variance = 0.0;
    const double *row = hollow(x, n, rows, count, &lowest);
    if (!row) continue;
    conditioned++;
    for (long i = 0; i < n; i++) {
      Ph[i] = 0.0;
      for (long j = 0; j < n; j++) Ph[i] += P[i * n + j] * row[j];
    }
    for (long i = 0; i < n; i++) variance += row[i] * Ph[i];
    if (!(variance > 0.0)) continue;
    const double sd = sqrt(variance), depth = -lowest / sd, rise = mills(depth);
    for (long i = 0; i < n; i++) x[i] += Ph[i] * (rise / sd);
    for (long i = 0; i < n; i++)
      for (long j = 0; j < n; j++) P[i * n + j] -= Ph[i] * Ph[j] * (rise * (rise - depth) / variance);
  }
  return conditioned;
}

/* last input of the kernels that compute NAMED at `t`: MOTION + RIG_INPUTS */
static void named_inputs(const Bank *bank, const Palms *palms, const RigError *rig, double t, double *v) {
  surfaces_at(palms, rig, t, v);
  friction_of(bank, rig);
  memcpy(v + MOTION, bank->rig, RIG_INPUTS * sizeof *v);
}

/* Predict NAMED of one filter from `t` to `t + dt`, with variances. `spread` (rows, steps): a square root of the covariance
   due to uncertain rig constants, rows of the n states, then of the constants themselves. `unmodelled`: variances that
   are added. */
void named(const Bank *bank, const Palms *palms, const RigError *rig, long member, double t, double dt,
           const double *spread, long rows, long steps, const double *unmodelled, double *y, double *variance) {
  enum { S = 3, PHI = 5, OMEGA = 6 }; /* S of palm 1, palm 2 next; PHI, OMEGA of joint 1, joint 2 two entries later */
  const long n = bank->n;
  const double *x = bank->x[bank->now[0]] + member * n, *P = bank->P[bank->now[0]] + member * n * n;
  double P_next[MOST_STATES * MOST_STATES], x_next[MOST_STATES], J[(MOST_STATES + JOINTS) * NAMED];
  double u[1 + MOTION + JOINTS + RIG_INPUTS], angles[JOINTS], rates[JOINTS], more[JOINTS], by[JOINTS][JOINTS];
  prediction_inputs(bank, palms, rig, t, dt, u);
  const double *in[] = {x, P, u};
  double *out[] = {x_next, P_next};
  bank->predict_one(in, out, 1);
  double v[MOTION + RIG_INPUTS];
  named_inputs(bank, palms, rig, t + dt, v);
  const double *at[] = {x_next, v};
  double *outputs[] = {y, J};
  bank->named(at, outputs, 1);
  for (int i = 0; i < NAMED; i++) variance[i] = 0.0;
  for (long a = 0; a < n; a++) {
    double row[NAMED] = {0.0};
    for (long b = 0; b < n; b++)
      for (int i = 0; i < NAMED; i++) row[i] += P_next[a * n + b] * J[b * NAMED + i];
    for (int i = 0; i < NAMED; i++) variance[i] += J[a * NAMED + i] * row[i];
  }
  palms_variance(palms, t + dt, angles, rates);
  for (int j = 0; j < JOINTS; j++) {
    variance[PHI + 2 * j] += angles[j];
    variance[OMEGA + 2 * j] += rates[j];
  }
  for (int i = 0; i < NAMED; i++) variance[i] += unmodelled[i];
  bows(rig, rig->values, 1, more);
  for (int i = 0; i < JOINTS; i++) {
    lifts(rig, i, y[PHI + 2], x_next[RADIUS], by[i]);
    for (int k = 0; k < JOINTS; k++) y[S + i] += by[i][k] * height(rig, k, rig->values, 1);
  }
  for (int j = 0; j < JOINTS; j++) y[PHI + 2 * j] -= more[j];
  for (long k = 0; k < steps; k++) {
    double open[NAMED] = {0.0};
    for (long a = 0; a < n; a++)
      for (int i = 0; i < NAMED; i++) open[i] += J[a * NAMED + i] * spread[a * steps + k];
    if (rows > n) {
      const double *own = spread + n * steps + k;
      bows(rig, own, steps, more);
      for (int j = 0; j < JOINTS; j++)
        for (int i = 0; i < NAMED; i++) open[i] += J[(n + j) * NAMED + i] * (own[(TILT + j) * steps] + more[j]);
      for (int j = 0; j < JOINTS; j++) open[PHI + 2 * j] -= more[j];
      for (int i = 0; i < JOINTS; i++)
        for (int p = 0; p < JOINTS; p++) open[S + i] += by[i][p] * height(rig, p, own, steps);
    }
    for (int i = 0; i < NAMED; i++) variance[i] += open[i] * open[i];
  }
}

/* Standard deviation of NAMED over the filters whose score is within `margin` of the best, about the best one's, weighted
   by likelihood. Returns their number, the best included; `sd` is not set if it is alone. Differences of ψ are wrapped,
   and ignored (0) unless the filters share `one_gauge`. */
long disagreement(Bank *bank, const Palms *palms, const RigError *rig, double t, double margin, long one_gauge, double *sd) {
  enum { PSI = 10 };
  const long size = size_of(bank), best = best_of(bank);
  const double *score = bank->score, least = score[best] - margin, *y = bank->y, turn = 2 * M_PI;
  double v[MOTION + RIG_INPUTS], weights = 0.0;
  long rivals = 0;
  for (long f = 0; f < size; f++) rivals += score[f] > least;
  if (rivals < 2) return rivals;
  named_inputs(bank, palms, rig, t, v);
  const double *in[] = {bank->x[bank->now[0]], v};
  double *out[] = {bank->y};
  bank->values(in, out, size);
  for (int i = 0; i < NAMED; i++) sd[i] = 0.0;
  for (long f = 0; f < size; f++) {
    if (!(score[f] > least)) continue;
    const double weight = exp(score[f] - score[best]);
    weights += weight;
    for (int i = 0; i < NAMED; i++) {
      double apart = y[f * NAMED + i] - y[best * NAMED + i];
      if (i == PSI) apart = one_gauge ? apart - turn * floor(apart / turn + 0.5) : 0.0;
      sd[i] += weight * (apart * apart);
    }
  }
  for (int i = 0; i < NAMED; i++) sd[i] = sqrt(sd[i] / weights);
  return rivals;
}

/* ---- events in the order of their times: `observer.fusion`, `observer.history` */

typedef struct {
  Reading reading;
  double t_before, *faded, *x, *P, *score, *nis; /* the bank before the reading */
} Fused;

typedef struct {
  double t, t_start, repeated; /* time of the bank; start of the track */
  double variances[JOINTS], shared[JOINTS]; /* of each pad's readings; how many share an error of place, once a smoother's estimate is continued */
  double *faded; /* when each block was faded last, infinity for those that never are */
  long early;    /* whether the first readings are linearised about an initial guess, with inflated noise */
  long count, waiting, moved;
  Fused fused[EVENTS]; /* the first `count` in order of time, the rest unused memory */
  Reading queue[EVENTS + 1];
} Fusion;

static const double EARLY_NOISE = 20.0, EARLY_S = 0.3, FORGET_EVERY_S = 0.2, FORGET_AT_LEAST_EVERY_S = 0.5;

static void copy(double *to, const double *from, long count) { memcpy(to, from, count * sizeof *to); }

static void remember(Fusion *fusion, const Bank *bank, long blocks) {
  const long n = bank->n, size = size_of(bank), side = bank->now[0];
  if (fusion->count == EVENTS) { /* full: the oldest can no longer be undone */
    const Fused oldest = fusion->fused[0];
    memmove(fusion->fused, fusion->fused + 1, (EVENTS - 1) * sizeof oldest);
    fusion->fused[--fusion->count] = oldest;
  }
  Fused *entry = &fusion->fused[fusion->count++];
  entry->reading = fusion->queue[0];
  entry->t_before = fusion->t;
  copy(entry->faded, fusion->faded, blocks);
  copy(entry->x, bank->x[side], size * n);
  copy(entry->P, bank->P[side], size * n * n);
  copy(entry->score, bank->score, size);
  copy(entry->nis, bank->nis, size);
}

static int undo(Fusion *fusion, Bank *bank, double t) {
  const long n = bank->n, size = size_of(bank), side = bank->now[0];
  long at = fusion->count;
  while (at > 0 && fusion->fused[at - 1].reading.t > t) at--;
  if (at == fusion->count || t < fusion->fused[at].t_before) return 0;
  const Fused *entry = &fusion->fused[at];
  for (long i = at; i < fusion->count; i++) fusion->queue[1 + i - at] = fusion->fused[i].reading;
  fusion->waiting += fusion->count - at;
  fusion->count = at;
  fusion->t = entry->t_before;
  copy(fusion->faded, entry->faded, bank->now[1]);
  copy(bank->x[side], entry->x, size * n);
  copy(bank->P[side], entry->P, size * n * n);
  copy(bank->score, entry->score, size);
  copy(bank->nis, entry->nis, size);
  return 1;
}

static long due(const Fusion *fusion, const Bank *bank) {
  const double age = fusion->t - fusion->t_start;
  long block = 0;
  for (long i = 1; i < bank->now[1]; i++)
    if (fusion->faded[i] < fusion->faded[block]) block = i;
  const int wait = fusion->t - fusion->faded[block] < fmin(fmax(FORGET_EVERY_S, age / 10), FORGET_AT_LEAST_EVERY_S);
  return wait ? -1 : block;
}

/* Fuse the waiting readings. Returns -1 when none is left, else the block that the caller must fade before it calls again. */
long fuse(Fusion *fusion, Bank *bank, const Palms *palms, const RigError *rig) {
  while (fusion->waiting) {
    const Reading *reading = &fusion->queue[0];
    if (!fusion->moved) {
      remember(fusion, bank, bank->now[1]);
      const int unexpected = bank->nis[best_of(bank)] > UNEXPECTED_NIS; /* then the contact is at another place */
      const double shared = fusion->early ? 1.0 : fusion->shared[reading->pad - 1];
      fusion->repeated = unexpected ? 1.0 : fmax(repetitions(palms), shared);
      carry(bank, palms, rig, fusion->t, reading->t, fusion->repeated);
      fusion->t = reading->t;
      fusion->moved = 1;
      const long block = due(fusion, bank);
      if (block >= 0) return block;
    }
    const double age = reading->t - fusion->t_start;
    const double inflation = fusion->early ? 1.0 + EARLY_NOISE * exp(-age / EARLY_S) : 1.0;
    read_pad(bank, palms, rig, reading, inflation * fusion->variances[reading->pad - 1], fusion->repeated);
    fusion->moved = 0;
    memmove(fusion->queue, fusion->queue + 1, --fusion->waiting * sizeof *reading);
  }
  return -1;
}

/* Add one reading and fuse it; a late one in the order of its time. Returns as `fuse`, or -2 if it is too late. */
long add(Fusion *fusion, Bank *bank, const Palms *palms, const RigError *rig, const Reading *reading) {
  fusion->queue[0] = *reading;
  fusion->waiting = 1;
  fusion->moved = 0;
  if (reading->t < fusion->t && !undo(fusion, bank, reading->t)) {
    fusion->waiting = 0;
    return -2;
  }
  return fuse(fusion, bank, palms, rig);
}
