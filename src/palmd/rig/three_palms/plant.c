/* One step of one body on three palms, described in `rig.three_palms.plant`; and the palms for given joints, see
   `system.three_palms.palms_at`. */

#include <math.h>
#include <string.h>

#define ELLIPSOIDS 2
#define VERTICES 12
#define PULL 100.0 /* 1/s, rate at which errors of the gaps decay */
#define INSTANTS 64 /* of the palms' vibrations, over which is averaged */
#define KINK 0.03
#define WAYS 3 /* directions of contact forces: along the normal, along the vibration, and across it */

typedef double Instant[3]; /* the palms' vibration speeds over their amplitude */

static const double PI = 3.14159265358979323846;

typedef struct {
  double ball, forms[ELLIPSOIDS][3][3], vertices[VERTICES][3], sharpness, offset[3], inertia[3][3];
  double mu, dither, drag, gravity;
} Scene; /* dither: pi V / 2, V the amplitude of a palm's vibration speed */

typedef struct {
  double normal[3][3], rate[3][3], acceleration[3][3], spin[3][3];
} Palms;

typedef struct {
  double p[3], v[3], R[3][3], w[3];
} State;

typedef struct {
  double point[3][3], force[3];
} Touch;

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static void times(const double A[3][3], const double *x, double *out) {
  for (int i = 0; i < 3; i++) out[i] = dot(A[i], x);
}

static void turned_back(const double A[3][3], const double *x, double *out) {
  for (int i = 0; i < 3; i++) out[i] = A[0][i] * x[0] + A[1][i] * x[1] + A[2][i] * x[2];
}

static void inverse(const double A[3][3], double out[3][3]) {
  double c[3][3];
  for (int i = 0; i < 3; i++) cross(A[(i + 1) % 3], A[(i + 2) % 3], c[i]);
  double det = dot(A[0], c[0]);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) out[i][j] = c[j][i] / det;
}

/* h, its gradient, and its Hessian times s, at the unit normal u */
static double support(const Scene *b, const double *u, const double *s, double *point, double *bent) {
  double h = b->ball - dot(b->offset, u), along = dot(u, s);
  for (int i = 0; i < 3; i++) {
    point[i] = b->ball * u[i] - b->offset[i];
    bent[i] = b->ball * (s[i] - u[i] * along);
  }
  for (int e = 0; e < ELLIPSOIDS; e++) {
    double pulled[3], pulled_s[3];
    times(b->forms[e], u, pulled);
    times(b->forms[e], s, pulled_s);
    double root = sqrt(dot(pulled, u)), share = dot(pulled, s) / (root * root);
    h += root;
    for (int i = 0; i < 3; i++) {
      point[i] += pulled[i] / root;
      bent[i] += (pulled_s[i] - pulled[i] * share) / root;
    }
  }
  double reach[VERTICES], top = 0.0, sum = 0.0, q = b->sharpness;
  for (int v = 0; v < VERTICES; v++) {
    reach[v] = fmax(0.0, dot(b->vertices[v], u));
    top = fmax(top, reach[v]);
  }
  for (int v = 0; v < VERTICES; v++) sum += pow(reach[v] / top, q);
  double size = top * pow(sum, 1.0 / q), corner[3] = {0}, spread[3] = {0};
  for (int v = 0; v < VERTICES; v++) {
    double share = reach[v] / size;
    if (share <= 0.0) continue;
    double first = pow(share, q - 1.0), second = first / share * dot(b->vertices[v], s);
    for (int i = 0; i < 3; i++) {
      corner[i] += first * b->vertices[v][i];
      spread[i] += second * b->vertices[v][i];
    }
  }
  double bend = (q - 1.0) / size, tilt = dot(corner, s);
  for (int i = 0; i < 3; i++) {
    point[i] += corner[i];
    bent[i] += bend * (spread[i] - corner[i] * tilt);
  }
  return h + size;
}

/* the direction of friction (along the vibration, across it) for a contact's slip (m/s) */
static void direction(double along, double across, double speed, double now, double *out) {
  const double slip = along + speed * now, size = sqrt(slip * slip + across * across + KINK * KINK * speed * speed);
  out[0] = slip / size, out[1] = across / size;
}

/* derivatives of the state, averaged over `count` instants of the vibrations */
static void rates(const Scene *b, const Palms *palms, const State *x, const Instant *instants, int count, State *out,
                  Touch *touch) {
  double J[3][3], J_inverse[3][3], RI[3][3], jacobian[3][6], wrench[3][WAYS][6], free[6] = {0, 0, -b->gravity}, wanted[3];
  double slips[3][2];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      RI[i][j] = 0.0;
      for (int k = 0; k < 3; k++) RI[i][j] += x->R[i][k] * b->inertia[k][j];
    }
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) J[i][j] = dot(RI[i], x->R[j]);
  inverse(J, J_inverse);
  double Jw[3], gyro[3], torque[3];
  times(J, x->w, Jw);
  cross(x->w, Jw, gyro);
  for (int i = 0; i < 3; i++) torque[i] = -b->drag * x->w[i] - gyro[i];
  times(J_inverse, torque, free + 3);
  for (int n = 0; n < 3; n++) {
    const double *normal = palms->normal[n], *rate = palms->rate[n], *bend = palms->acceleration[n];
    double u[3], s[3], local[3], bent[3], r[3], slide[3], turning[3], spinning[3];
    cross(x->w, normal, spinning);
    for (int i = 0; i < 3; i++) turning[i] = rate[i] - spinning[i]; /* of the normal, relative to the body */
    turned_back(x->R, normal, u);
    turned_back(x->R, turning, s);
    for (int i = 0; i < 3; i++) u[i] = -u[i], s[i] = -s[i];
    double h = support(b, u, s, local, bent), back[3];
    times(x->R, local, r);
    times(x->R, bent, back);
    cross(x->w, r, slide);
    double slip[3], carried[3], w_rate[3];
    for (int i = 0; i < 3; i++) touch->point[n][i] = x->p[i] + r[i];
    cross(palms->spin[n], touch->point[n], carried);
    for (int i = 0; i < 3; i++) slip[i] = x->v[i] + slide[i] - carried[i], slide[i] += back[i];
    double push[WAYS][3] = {{normal[0], normal[1], normal[2]}, {1.0, 0.0, 0.0}}, moment[3];
    if (n) cross(palms->normal[0], normal, push[1]);
    cross(normal, push[1], push[2]);
    for (int way = 0; way < WAYS; way++) {
      memcpy(wrench[n][way], push[way], sizeof push[way]);
      cross(r, push[way], moment);
      times(J_inverse, moment, wrench[n][way] + 3);
      if (way) slips[n][way - 1] = dot(slip, push[way]);
    }
    memcpy(jacobian[n], normal, sizeof push[0]);
    cross(r, normal, jacobian[n] + 3);
    cross(x->w, rate, w_rate);
    double gap = dot(normal, x->p) - h;
    double gap_rate = dot(normal, x->v) + dot(rate, x->p) + dot(r, turning);
    double bias = 2.0 * dot(rate, x->v) + dot(bend, x->p) + dot(slide, turning) + dot(r, bend) - dot(r, w_rate);
    wanted[n] = -bias - 2.0 * PULL * gap_rate - PULL * PULL * gap;
    wanted[n] -= dot(jacobian[n], free) + dot(jacobian[n] + 3, free + 3);
  }
  double by[3][3][WAYS], push[3][WAYS] = {{0}}; /* gap accelerations by unit forces; mean forces */
  for (int n = 0; n < 3; n++)
    for (int m = 0; m < 3; m++)
      for (int way = 0; way < WAYS; way++)
        by[n][m][way] = dot(jacobian[n], wrench[m][way]) + dot(jacobian[n] + 3, wrench[m][way] + 3);
  for (int k = 0; k < count; k++) {
    double A[3][3], A_inverse[3][3], force[3], rubs[3][2];
    for (int m = 0; m < 3; m++) direction(slips[m][0], slips[m][1], 2.0 / PI * b->dither, instants[k][m], rubs[m]);
    for (int n = 0; n < 3; n++)
      for (int m = 0; m < 3; m++) A[n][m] = by[n][m][0] - b->mu * (by[n][m][1] * rubs[m][0] + by[n][m][2] * rubs[m][1]);
    inverse(A, A_inverse);
    times(A_inverse, wanted, force);
    for (int m = 0; m < 3; m++) {
      push[m][0] += force[m] / count;
      for (int way = 1; way < WAYS; way++) push[m][way] -= b->mu * rubs[m][way - 1] * force[m] / count;
    }
  }
  for (int m = 0; m < 3; m++) touch->force[m] = push[m][0];
  for (int i = 0; i < 3; i++) {
    out->p[i] = x->v[i];
    out->v[i] = free[i];
    out->w[i] = free[3 + i];
    for (int n = 0; n < 3; n++)
      for (int way = 0; way < WAYS; way++) {
        out->v[i] += push[n][way] * wrench[n][way][i];
        out->w[i] += push[n][way] * wrench[n][way][3 + i];
      }
  }
  for (int j = 0; j < 3; j++) {
    double column[3] = {x->R[0][j], x->R[1][j], x->R[2][j]}, moved[3];
    cross(x->w, column, moved);
    for (int i = 0; i < 3; i++) out->R[i][j] = moved[i];
  }
}

static State moved(const State *x, const State *by, double dt) {
  State out = *x;
  double *to = (double *)&out;
  const double *rate = (const double *)by;
  for (unsigned i = 0; i < sizeof(State) / sizeof(double); i++) to[i] += dt * rate[i];
  return out;
}

/* one Newton step towards the nearest rotation */
static void straighten(State *state) {
  double gram[3][3], R[3][3];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      gram[i][j] = 1.5 * (i == j);
      for (int m = 0; m < 3; m++) gram[i][j] -= 0.5 * state->R[m][i] * state->R[m][j];
    }
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      R[i][j] = 0.0;
      for (int m = 0; m < 3; m++) R[i][j] += state->R[i][m] * gram[m][j];
    }
  memcpy(state->R, R, sizeof R);
}

/* palms: at the beginning, midway and at the end. lattice, shift: phases (rad) at `INSTANTS`, over which is averaged.
   Replaces the state by that after dt (s), and returns its contacts. */
void three_palms_step(const Scene *scene, const Palms *palms, const double (*lattice)[3], const double *shift, double dt,
                      State *state, Touch *touch) {
  State k[4], at, mean;
  Touch later;
  Instant instants[INSTANTS];
  for (int n = 0; n < INSTANTS; n++)
    for (int m = 0; m < 3; m++) instants[n][m] = cos(lattice[n][m] + shift[m]);
  rates(scene, &palms[0], state, instants, INSTANTS, &k[0], &later);
  at = moved(state, &k[0], 0.5 * dt);
  rates(scene, &palms[1], &at, instants, INSTANTS, &k[1], &later);
  at = moved(state, &k[1], 0.5 * dt);
  rates(scene, &palms[1], &at, instants, INSTANTS, &k[2], &later);
  at = moved(state, &k[2], dt);
  rates(scene, &palms[2], &at, instants, INSTANTS, &k[3], &later);
  double *sum = (double *)&mean;
  for (unsigned i = 0; i < sizeof(State) / sizeof(double); i++)
    sum[i] = (((double *)&k[0])[i] + 2.0 * ((double *)&k[1])[i] + 2.0 * ((double *)&k[2])[i] + ((double *)&k[3])[i]) / 6.0;
  *state = moved(state, &mean, dt);
  straighten(state);
  rates(scene, &palms[2], state, instants, INSTANTS, &mean, touch);
}

/* The palms a share of the way from palms[0] to palms[2], by the parabola through all three. */
static void palms_between(const Palms *palms, double share, Palms *out) {
  const double w[3] = {(1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)};
  const double *at[3] = {(const double *)&palms[0], (const double *)&palms[1], (const double *)&palms[2]};
  double *to = (double *)out;
  for (unsigned i = 0; i < sizeof(Palms) / sizeof(double); i++) to[i] = w[0] * at[0][i] + w[1] * at[1][i] + w[2] * at[2][i];
}

/* The same with the vibrations resolved, in `count` steps of the midpoint rule. phase: of each palm, updated; rate: of
   the phases (rad/s). force: of a sensor with the time constant `slow` (s). */
void three_palms_vibrate(const Scene *scene, const Palms *palms, double *phase, const double *rate, double slow, long count,
                         double dt, State *state, Touch *touch) {
  const double h = dt / count, kept = exp(-h / slow);
  double force[3];
  memcpy(force, touch->force, sizeof force);
  for (long n = 0; n < count; n++) {
    State by, middle;
    Palms at;
    Instant now;
    palms_between(palms, (double)n / count, &at);
    for (int i = 0; i < 3; i++) now[i] = cos(phase[i]);
    rates(scene, &at, state, (const Instant *)&now, 1, &by, touch);
    middle = moved(state, &by, 0.5 * h);
    palms_between(palms, (n + 0.5) / count, &at);
    for (int i = 0; i < 3; i++) now[i] = cos(phase[i] + 0.5 * h * rate[i]);
    rates(scene, &at, &middle, (const Instant *)&now, 1, &by, touch);
    *state = moved(state, &by, h);
    for (int i = 0; i < 3; i++) {
      phase[i] = fmod(phase[i] + h * rate[i], 2.0 * PI);
      force[i] = force[i] > 0.0 ? kept * force[i] + (1.0 - kept) * touch->force[i] : touch->force[i];
    }
  }
  straighten(state);
  memcpy(touch->force, force, sizeof force);
}

/* Shift by one instant; palms[2] and its pads' axes (a, b) from angles, rates, accelerations of beta, gamma2, gamma3. */
void three_palms_turn(Palms *palms, double axes[3][2][3], const double joints[3][3]) {
  const double *angle = joints[0], *rate = joints[1], *acceleration = joints[2];
  double c[3], s[3];
  for (int i = 0; i < 3; i++) c[i] = cos(angle[i]), s[i] = sin(angle[i]);
  const double edge[3] = {1.0, 0.0, 0.0}, up[3] = {0.0, c[0], s[0]}, n1[3] = {0.0, -s[0], c[0]};
  const double across[3] = {0.0, c[1], -c[2]}, along[3] = {0.0, s[1], s[2]}; /* normals 2 and 3 of edge and up */
  const double turn[3] = {0.0, rate[1], -rate[2]}, turning[3] = {0.0, acceleration[1], -acceleration[2]};
  palms[0] = palms[1];
  palms[1] = palms[2];
  Palms *now = &palms[2];
  for (int n = 0; n < 3; n++) {
    double side = n == 2 ? 1.0 : -1.0, carried[3], spin_rate[3], bent[3];
    for (int i = 0; i < 3; i++) {
      now->normal[n][i] = n ? across[n] * edge[i] + along[n] * up[i] : n1[i];
      axes[n][0][i] = n ? side * along[n] * edge[i] - side * across[n] * up[i] : edge[i];
      axes[n][1][i] = n ? n1[i] : up[i];
      now->spin[n][i] = rate[0] * edge[i] + turn[n] * n1[i];
    }
    cross(edge, n1, carried);
    for (int i = 0; i < 3; i++)
      spin_rate[i] = acceleration[0] * edge[i] + turning[n] * n1[i] + turn[n] * rate[0] * carried[i];
    cross(now->spin[n], now->normal[n], now->rate[n]);
    cross(spin_rate, now->normal[n], now->acceleration[n]);
    cross(now->spin[n], now->rate[n], bent);
    for (int i = 0; i < 3; i++) now->acceleration[n][i] += bent[i];
  }
}
