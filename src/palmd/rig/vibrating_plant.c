/* A body between two palms that vibrate along themselves, with dry Coulomb friction, resolved in time; the method is
   described in `rig.vibrating_plant`.

   A contact slips forwards (+1) or backwards (-1) along t, with friction -mode * mu * f along t, or sticks (0), with the
   friction that keeps the slip at zero. Modes are constant within a step: a step ends where a slip reaches zero, or where
   a sticking contact needs more than mu * f, and the modes are chosen again. Palms are arcs through the hinge (flat:
   curvature 0), the geometry is that of `rig.curved_plant`. */

#include <math.h>

#define NODES 2048 /* of a support function's table */
#define SHAKING 3

static const double PI = 3.141592653589793, TAU = 6.283185307179586;

typedef struct {
  double angles[2], rates[2], accelerations[2];
} Palms;

typedef struct { /* of one palm: `simulate.Rock`, with its rests as (from, to) */
  double mean, amplitude, frequency, phase;
  const double (*rests)[2];
  long resting;
} Rock;

typedef struct { /* of both palms; `off`: error of each joint angle (rad), `lag`: delay (s) */
  Rock rocks[2];
  double off[2], lag;
} Rocking;

typedef struct { /* bounds of a contact, in N and m */
  double mass, least, low, high;
} ContactBounds;

typedef struct {
  double t, psi, omega0, r[2], s[2], angles[2], force[2];
} Row;

typedef struct {
  double h, first, second;
} Support;

static inline Support support_at(const double (*table)[4], double theta) {
  const double per_rad = NODES / TAU, position = theta * per_rad, node = rint(position);
  const double e = (position - node) / per_rad, *row = table[(long)node & (NODES - 1)];
  const double h = row[0], h1 = row[1], half_h2 = row[2], sixth_h3 = row[3];
  return (Support){h + e * (h1 + e * (half_h2 + e * sixth_h3)), h1 + e * (2.0 * half_h2 + e * 3.0 * sixth_h3),
                   2.0 * half_h2 + e * 6.0 * sixth_h3};
}

typedef struct {
  double value, rate, acceleration;
} SmoothStep;

static inline SmoothStep smooth_step(double t) {
  if (t >= 1.0) return (SmoothStep){1.0, 0.0, 0.0};
  const double u = fmax(t, 0.0), left = 1.0 - u;
  return (SmoothStep){u * u * u * (10.0 - 15.0 * u + 6.0 * u * u), 30.0 * u * u * (left * left),
                 60.0 * u * left * (1.0 - 2.0 * u)};
}

static inline SmoothStep rocked(const Rock *rock, double t) {
  SmoothStep w = smooth_step(t);
  for (long i = 0; i < rock->resting; i++) {
    const double begin = rock->rests[i][0], end = rock->rests[i][1];
    if (!(begin < t && t < end + 1.0)) continue;
    const SmoothStep out = smooth_step(t - begin), back = smooth_step(t - end);
    const double v = back.value - out.value + 1.0, dv = back.rate - out.rate;
    const double ddv = back.acceleration - out.acceleration;
    w = (SmoothStep){w.value * v, w.rate * v + w.value * dv, w.acceleration * v + 2.0 * w.rate * dv + w.value * ddv};
  }
  const double k = TAU * rock->frequency, s = sin(k * t + rock->phase), c = cos(k * t + rock->phase);
  const double a = rock->amplitude;
  return (SmoothStep){rock->mean + a * w.value * s, a * (w.rate * s + w.value * k * c),
                 a * (w.acceleration * s + 2.0 * w.rate * k * c - w.value * k * k * s)};
}

static inline Palms palms_at(const Rocking *rocking, double t) {
  Palms palms;
  for (int i = 0; i < 2; i++) {
    const SmoothStep nominal = rocked(&rocking->rocks[i], t);
    palms.angles[i] = nominal.value + rocking->off[i];
    palms.rates[i] = nominal.rate, palms.accelerations[i] = nominal.acceleration;
  }
  return palms;
}

#define CONTACTS 2
#define UNKNOWNS 4
#define CROSSINGS 12 /* of zero slip in one step; the rest of the step is then integrated without further divisions */
#define NEWTON 6

static const double AHEAD_S = 1e-6;    /* time difference for the rate of a slip */
static const double LOCATED_S = 1e-10; /* accuracy of a reversal's time */
static const double FOUND_RAD = 1e-13, LONGEST_RAD = 0.2;

typedef struct {
  double curvature, slope, standoff, reach, mu;
  double frequency, speed, phase, second, third, inwards; /* outward speed, and its sign in the slip */
  double yielding, stiffness, damping; /* body's mass over the palm's, 0 if rigid; both others per unit of palm mass */
} Palm;

typedef struct { /* of one body on one rig */
  const double (*table)[4];
  double rho2, damping, gravity, shake, shaking_hz[SHAKING], travel, base[2];
  double drift_rate, soft_blow, parting, lost_distance, longest_step, force_lag;
  Palm palms[CONTACTS];
  long arc;
} Scene;

typedef struct {
  double x, y, psi, vx, vy, w, give[CONTACTS], giving[CONTACTS]; /* `give`: palm's displacement away from the body */
} State;

typedef struct {
  double ax, ay, al, f[CONTACTS], given[CONTACTS], ratio[CONTACTS]; /* ratio: friction against t over normal force */
} Rates;

typedef struct {
  State state;
  Rates rates;
  double t, fallen, on[CONTACTS], mode[CONTACTS], theta[CONTACTS], preload[CONTACTS];
  double s[CONTACTS], r[CONTACTS], force[CONTACTS], least[CONTACTS], reversals[CONTACTS], stuck_s[CONTACTS];
  double slow[2][CONTACTS]; /* forces after each of two low-pass stages */
} Body;

typedef struct {
  double nu[CONTACTS][2], out[CONTACTS], along[CONTACTS][2], w[CONTACTS], al[CONTACTS], ox, oy, vox, voy, aox, aoy;
} Frame;

typedef struct { /* one contact */
  double nx, ny, tx, ty, lever, arm, b, slip, px, py, gap, rate;
} Contact;

typedef struct { /* palms during one step: given at two times, or rocking */
  const Palms *middle, *end;
  double t_end, dt;
  const Rocking *rocking;
} Motion;

static Palms moved(const Palms *palms, double by) {
  Palms after = *palms;
  for (int i = 0; i < 2; i++) {
    after.angles[i] += by * (palms->rates[i] + 0.5 * by * palms->accelerations[i]);
    after.rates[i] += by * palms->accelerations[i];
  }
  return after;
}

static Palms palms_of(const Motion *motion, double t) {
  if (motion->rocking) return palms_at(motion->rocking, t - motion->rocking->lag);
  const double before = motion->t_end - t;
  return before > 0.5 * motion->dt ? moved(motion->middle, 0.5 * motion->dt - before) : moved(motion->end, -before);
}

static Frame frame_of(const Scene *scene, const Palms *palms) {
  const double phi1 = palms->angles[0], phi12 = phi1 + palms->angles[1];
  const double w1 = palms->rates[0], a1 = palms->accelerations[0], c1 = cos(phi1), s1 = sin(phi1);
  const double c12 = cos(phi12), s12 = sin(phi12);
  Frame f = {.ox = scene->base[0], .oy = scene->base[1]};
  if (scene->arc) {
    const double length = scene->travel;
    f.ox -= length * c1, f.oy -= length * s1;
    f.vox = length * w1 * s1, f.voy = -length * w1 * c1;
    f.aox = length * (a1 * s1 + w1 * w1 * c1), f.aoy = length * (w1 * w1 * s1 - a1 * c1);
  }
  const double normals[2][2] = {{-s1, c1}, {s12, -c12}};
  for (int i = 0; i < CONTACTS; i++) {
    const double slope = scene->palms[i].slope, c = slope ? cos(slope) : 1.0, s = slope ? sin(slope) : 0.0;
    f.out[i] = slope + (i ? phi12 + 0.5 * PI : phi1 - 0.5 * PI); /* opposite to the normal */
    f.nu[i][0] = c * normals[i][0] - s * normals[i][1], f.nu[i][1] = s * normals[i][0] + c * normals[i][1];
  }
  f.along[0][0] = c1, f.along[0][1] = s1, f.along[1][0] = c12, f.along[1][1] = s12;
  f.w[0] = w1, f.w[1] = w1 + palms->rates[1], f.al[0] = a1, f.al[1] = a1 + palms->accelerations[1];
  return f;
}

static double gravity_at(const Scene *scene, double t) {
  if (scene->shake == 0.0) return scene->gravity;
  double swings = 0.0;
  for (int i = 0; i < SHAKING; i++) swings += sin(TAU * scene->shaking_hz[i] * t);
  return scene->gravity + scene->shake * swings;
}

static double vibration_at(const Palm *palm, double t) { /* its contribution to the slip */
  const double tau = TAU * palm->frequency * t + palm->phase;
  double wave = cos(tau);
  if (palm->second != 0.0) wave += palm->second * cos(2.0 * tau);
  if (palm->third != 0.0) wave += palm->third * cos(3.0 * tau);
  return palm->inwards * palm->speed * wave;
}

/* The contact point of body and palm, and the rates of gap and slip; equations of `rig.curved_plant`. */
static Contact contact_of(const Scene *scene, int i, const Frame *f, const State *q, double t, double *theta_io) {
  const Palm *palm = &scene->palms[i];
  const double nux = f->nu[i][0], nuy = f->nu[i][1], kappa = palm->curvature, rx = q->x - f->ox, ry = q->y - f->oy;
  double theta = *theta_io, c, s, wx, wy, yx, yy, nx, ny, v;
  if (kappa == 0.0) theta = f->out[i] - q->psi;
  for (int left = NEWTON;; left--) {
    const Support at = support_at(scene->table, theta);
    const double h = at.h + palm->standoff;
    if (kappa == 0.0)
      c = -nux, s = -nuy;
    else
      c = cos(theta + q->psi), s = sin(theta + q->psi);
    v = h + at.second, yx = h * c - at.first * s, yy = h * s + at.first * c;
    wx = rx + yx, wy = ry + yy, nx = nux - kappa * wx, ny = nuy - kappa * wy;
    const double step = (ny * c - nx * s) / (nx * c + ny * s + kappa * v);
    if (fabs(step) < FOUND_RAD || !left || kappa == 0.0) break;
    theta += fmax(-LONGEST_RAD, fmin(LONGEST_RAD, step));
  }
  *theta_io = theta;
  const double wi = f->w[i], al = f->al[i], w = q->w;
  const double px = q->vx - f->vox - w * yy, py = q->vy - f->voy + w * yx, rate_x = -wi * nuy, rate_y = wi * nux;
  double b = (-al * nuy - wi * wi * nux) * wx + (al * nux - wi * wi * nuy) * wy + 2.0 * (rate_x * px + rate_y * py) -
             kappa * (px * px + py * py) - nx * (f->aox + w * w * yx) - ny * (f->aoy + w * w * yy);
  const double length = -(nx * c + ny * s);
  const double going = (rate_y - kappa * py) * c - (rate_x - kappa * px) * s + w * length;
  b -= v * going * going / (length - kappa * v);
  const double gap = nux * wx + nuy * wy - 0.5 * kappa * (wx * wx + wy * wy) + q->give[i];
  const double rate = nx * px + ny * py + rate_x * wx + rate_y * wy + q->giving[i];
  b += scene->drift_rate * (2.0 * rate + scene->drift_rate * gap);
  const double rub_x = yx - palm->standoff * c, rub_y = yy - palm->standoff * s; /* the body's own point */
  const double at_x = wx - palm->standoff * c, at_y = wy - palm->standoff * s;
  const double slip = -s * (q->vx - f->vox - w * rub_y + wi * at_y) + c * (q->vy - f->voy + w * rub_x - wi * at_x) +
                      vibration_at(palm, t);
  return (Contact){nx, ny, -s, c, yx * ny - yy * nx, c * rub_x + s * rub_y, b, slip, rub_x, rub_y, gap, rate};
}

static int eliminated(double m[UNKNOWNS][UNKNOWNS + 1], int n) { /* Gauss with pivoting; 0 if singular */
  for (int k = 0; k < n; k++) {
    int best = k;
    for (int i = k + 1; i < n; i++)
      if (fabs(m[i][k]) > fabs(m[best][k])) best = i;
    if (fabs(m[best][k]) < 1e-9) return 0;
    for (int j = k; j <= n; j++) {
      const double held = m[k][j];
      m[k][j] = m[best][j], m[best][j] = held;
    }
    for (int i = 0; i < n; i++) {
      if (i == k) continue;
      const double share = m[i][k] / m[k][k];
      for (int j = k; j <= n; j++) m[i][j] -= share * m[k][j];
    }
  }
  for (int k = 0; k < n; k++) m[k][n] /= m[k][k];
  return 1;
}

/* Accelerations for the contacts' present modes; `drag`: slip rates of sticking contacts without contact forces. Returns
   0 if there is no solution. */
static int forced(const Scene *scene, const Body *body, const State *q, double t, const Contact *at, const double *drag,
                  Rates *out) {
  const double g = gravity_at(scene, t), rho2 = scene->rho2, damping = -scene->damping * q->w / rho2;
  double fx[UNKNOWNS], fy[UNKNOWNS], torque[UNKNOWNS], m[UNKNOWNS][UNKNOWNS + 1];
  int of[UNKNOWNS], sticks[UNKNOWNS], n = 0;
  for (int pass = 0; pass < 2; pass++) /* normal forces first, then the friction of sticking contacts */
    for (int i = 0; i < CONTACTS; i++) {
      if (!body->on[i] || (pass && body->mode[i] != 0.0)) continue;
      const double k = pass ? 0.0 : body->mode[i] * scene->palms[i].mu, nx = -at[i].ty, ny = at[i].tx;
      /* the palm's unit normal is (-ty, tx): t is its tangent */
      fx[n] = pass ? -at[i].tx : nx - k * at[i].tx, fy[n] = pass ? -at[i].ty : ny - k * at[i].ty;
      torque[n] = at[i].px * fy[n] - at[i].py * fx[n];
      of[n] = i, sticks[n] = pass, n++;
    }
  for (int row = 0; row < n; row++) {
    const Contact *c = &at[of[row]];
    const Palm *palm = &scene->palms[of[row]];
    const double nx = sticks[row] ? c->tx : c->nx, ny = sticks[row] ? c->ty : c->ny, lever = sticks[row] ? c->arm : c->lever;
    for (int j = 0; j < n; j++) m[row][j] = nx * fx[j] + ny * fy[j] + lever * torque[j] / rho2;
    double rest = (sticks[row] ? drag[of[row]] + scene->drift_rate * c->slip : c->b) - ny * g + lever * damping;
    if (!sticks[row] && palm->yielding != 0.0) {
      m[row][row] += palm->yielding;
      rest -= palm->yielding * body->preload[of[row]] + palm->stiffness * q->give[of[row]] +
              palm->damping * q->giving[of[row]];
    }
    m[row][n] = -rest;
  }
  if (!eliminated(m, n)) return 0;
  *out = (Rates){0.0, -g, damping, {0}, {0}, {0}};
  for (int j = 0; j < n; j++) {
    const double f = m[j][n];
    out->ax += f * fx[j], out->ay += f * fy[j], out->al += f * torque[j] / rho2;
    if (sticks[j])
      out->ratio[of[j]] = out->f[of[j]] > 0.0 ? f / out->f[of[j]] : copysign(HUGE_VAL, f);
    else
      out->f[of[j]] = f, out->ratio[of[j]] = body->mode[of[j]] * scene->palms[of[j]].mu;
  }
  for (int i = 0; i < CONTACTS; i++) {
    const Palm *palm = &scene->palms[i];
    if (palm->yielding != 0.0)
      out->given[i] = palm->yielding * (out->f[i] - body->preload[i]) - palm->stiffness * q->give[i] -
                      palm->damping * q->giving[i];
  }
  return 1;
}

/* The state after dt by the velocities of `v`, and by accelerations if given. */
static State ahead(const State *q, const State *v, const Rates *r, double dt) {
  State after = {q->x + dt * v->vx, q->y + dt * v->vy, q->psi + dt * v->w, q->vx, q->vy, q->w, {0}, {0}};
  if (r) after.vx += dt * r->ax, after.vy += dt * r->ay, after.w += dt * r->al;
  for (int i = 0; i < CONTACTS; i++) {
    after.give[i] = q->give[i] + dt * v->giving[i];
    after.giving[i] = q->giving[i] + (r ? dt * r->given[i] : 0.0);
  }
  return after;
}

/* Rates of the slips by a forward difference, without contact forces (r 0) or for the accelerations r. */
static void slip_rates(const Scene *scene, const Body *body, const Palms *palms, const State *q, double t,
                       const Contact *at, const Rates *r, double *rates) {
  const Palms later = moved(palms, AHEAD_S);
  const Frame frame = frame_of(scene, &later);
  const State after = ahead(q, q, r, AHEAD_S);
  for (int i = 0; i < CONTACTS; i++) {
    double theta = body->theta[i];
    rates[i] = body->on[i] ? (contact_of(scene, i, &frame, &after, t + AHEAD_S, &theta).slip - at[i].slip) / AHEAD_S : 0.0;
  }
}

static int solve(const Scene *scene, Body *body, const Palms *palms, const Frame *frame, const State *q, double t,
                 Rates *out) {
  Contact at[CONTACTS] = {0};
  double drag[CONTACTS] = {0};
  int sticking = 0;
  for (int i = 0; i < CONTACTS; i++) {
    if (!body->on[i]) continue;
    at[i] = contact_of(scene, i, frame, q, t, &body->theta[i]);
    sticking |= body->mode[i] == 0.0;
  }
  if (sticking) slip_rates(scene, body, palms, q, t, at, 0, drag);
  return forced(scene, body, q, t, at, drag, out);
}

/* Choose the modes of contacts at zero slip, and compute the accelerations: the first modes that the law of friction
   allows, trying a reversal before continuation and both before sticking; otherwise those that violate it least. */
static void choose_modes(const Scene *scene, Body *body, const Palms *palms, const Frame *frame, double t,
                         const int *resting) {
  const double before[CONTACTS] = {body->mode[0], body->mode[1]};
  Contact at[CONTACTS] = {0};
  double drag[CONTACTS] = {0}, least = HUGE_VAL;
  for (int i = 0; i < CONTACTS; i++)
    if (body->on[i]) at[i] = contact_of(scene, i, frame, &body->state, t, &body->theta[i]);
  slip_rates(scene, body, palms, &body->state, t, at, 0, drag);
  Rates best = body->rates;
  double modes[CONTACTS] = {before[0], before[1]};
  for (int candidate = 0; candidate < 9; candidate++) {
    const int which[CONTACTS] = {candidate % 3, candidate / 3};
    int open = 1;
    for (int i = 0; i < CONTACTS; i++) {
      const double first = before[i] != 0.0 ? before[i] : 1.0, order[3] = {-first, first, 0.0};
      open &= resting[i] || which[i] == 0;
      body->mode[i] = resting[i] ? order[which[i]] : before[i];
    }
    Rates r;
    if (!open || !forced(scene, body, &body->state, t, at, drag, &r)) continue;
    double rates[CONTACTS], against = 0.0;
    slip_rates(scene, body, palms, &body->state, t, at, &r, rates);
    for (int i = 0; i < CONTACTS; i++) {
      if (!body->on[i]) continue;
      if (r.f[i] < 0.0) against += -r.f[i];
      if (!resting[i]) continue;
      const double mu = scene->palms[i].mu;
      if (body->mode[i] == 0.0)
        against += fmax(fabs(r.ratio[i]) - mu, 0.0) * fabs(r.f[i]);
      else
        against += fmax(-body->mode[i] * rates[i], 0.0);
    }
    if (against < least) {
      least = against, best = r;
      for (int i = 0; i < CONTACTS; i++) modes[i] = body->mode[i];
    }
    if (against == 0.0) break;
  }
  for (int i = 0; i < CONTACTS; i++) {
    body->mode[i] = modes[i];
    if (resting[i] && modes[i] != before[i]) body->reversals[i] += 1.0;
  }
  body->rates = best;
}

static void settle(const Scene *scene, Body *body, const Palms *palms, double t);

/* One Runge-Kutta step in the present modes; returns 0 if they have no solution. */
static int integrate(const Scene *scene, Body *body, const Motion *motion, double dt, Palms *palms, Frame *frame,
                     double *impulse) {
  const double half = 0.5 * dt, sixth = dt / 6.0, t = body->t;
  const Palms mid = palms_of(motion, t + half), end = palms_of(motion, t + dt);
  const Frame mid_frame = frame_of(scene, &mid), end_frame = frame_of(scene, &end);
  const State q = body->state;
  const Rates r1 = body->rates;
  Rates r2, r3, r4;
  const State q2 = ahead(&q, &q, &r1, half);
  if (!solve(scene, body, &mid, &mid_frame, &q2, t + half, &r2)) return 0;
  const State q3 = ahead(&q, &q2, &r2, half);
  if (!solve(scene, body, &mid, &mid_frame, &q3, t + half, &r3)) return 0;
  const State q4 = ahead(&q, &q3, &r3, dt);
  if (!solve(scene, body, &end, &end_frame, &q4, t + dt, &r4)) return 0;
  State *after = &body->state;
  after->x = q.x + sixth * (q.vx + 2.0 * (q2.vx + q3.vx) + q4.vx);
  after->y = q.y + sixth * (q.vy + 2.0 * (q2.vy + q3.vy) + q4.vy);
  after->psi = q.psi + sixth * (q.w + 2.0 * (q2.w + q3.w) + q4.w);
  after->vx = q.vx + sixth * (r1.ax + 2.0 * (r2.ax + r3.ax) + r4.ax);
  after->vy = q.vy + sixth * (r1.ay + 2.0 * (r2.ay + r3.ay) + r4.ay);
  after->w = q.w + sixth * (r1.al + 2.0 * (r2.al + r3.al) + r4.al);
  for (int i = 0; i < CONTACTS; i++) {
    after->give[i] = q.give[i] + sixth * (q.giving[i] + 2.0 * (q2.giving[i] + q3.giving[i]) + q4.giving[i]);
    after->giving[i] = q.giving[i] + sixth * (r1.given[i] + 2.0 * (r2.given[i] + r3.given[i]) + r4.given[i]);
    impulse[i] = sixth * (r1.f[i] + 2.0 * (r2.f[i] + r3.f[i]) + r4.f[i]);
  }
  body->t = t + dt;
  *palms = end, *frame = end_frame;
  return 1;
}

static void slips_of(const Scene *scene, Body *body, const Frame *frame, double *slips) {
  for (int i = 0; i < CONTACTS; i++)
    slips[i] = body->on[i] ? contact_of(scene, i, frame, &body->state, body->t, &body->theta[i]).slip : 0.0;
}

/* Time from t at which a contact slipping in `mode` reaches zero slip; the body's own part of the slip is linear. */
static double reversal(const Palm *palm, double t, double dt, double before, double after, double mode) {
  const double from = before - vibration_at(palm, t), to = after - vibration_at(palm, t + dt);
  double low = 0.0, high = dt;
  while (high - low > LOCATED_S) {
    const double middle = 0.5 * (low + high);
    if (mode * (from + (to - from) * middle / dt + vibration_at(palm, t + middle)) < 0.0)
      high = middle;
    else
      low = middle;
  }
  return high;
}

/* Advance by dt, divided at the reversals. */
static void go_on(const Scene *scene, Body *body, const Motion *motion, double dt, Palms *palms, Frame *frame) {
  double left = dt;
  for (int crossing = 0; left > 0.0 && !body->fallen; crossing++) {
    const Body start = *body;
    double before[CONTACTS], after[CONTACTS], impulse[CONTACTS], piece = left;
    const Frame frame_before = *frame;
    slips_of(scene, body, &frame_before, before);
    int solved = integrate(scene, body, motion, piece, palms, frame, impulse), resting[CONTACTS] = {0, 0};
    if (solved) {
      slips_of(scene, body, frame, after);
      Rates end = body->rates;
      const int sticking = body->mode[0] == 0.0 || body->mode[1] == 0.0;
      if (sticking) solved = solve(scene, body, palms, frame, &body->state, body->t, &end);
      for (int i = 0; i < CONTACTS && solved; i++) {
        if (!body->on[i]) continue;
        double piece_end = piece;
        int mode_ends = 0;
        if (body->mode[i] != 0.0 && body->mode[i] * after[i] < 0.0) {
          piece_end = reversal(&scene->palms[i], start.t, left, before[i], after[i], body->mode[i]), mode_ends = 1;
        } else if (body->mode[i] == 0.0 && fabs(end.ratio[i]) > scene->palms[i].mu) {
          const double from = fabs(start.rates.ratio[i]), to = fabs(end.ratio[i]), mu = scene->palms[i].mu;
          piece_end = from < mu && to < HUGE_VAL ? left * (mu - from) / (to - from) : 0.5 * left, mode_ends = 1;
        }
        if (mode_ends && piece_end <= piece) {
          if (piece_end < piece) resting[0] = resting[1] = 0;
          piece = piece_end, resting[i] = 1;
        }
      }
    }
    piece = crossing < CROSSINGS ? fmax(piece, 0.0) : left; /* contacts may stop again at once, endlessly */
    if (solved && crossing < CROSSINGS && (resting[0] || resting[1]) && piece < left) {
      *body = start, *frame = frame_before;
      if (piece > 0.0) solved = integrate(scene, body, motion, piece, palms, frame, impulse);
    }
    if (!solved) { /* no forces are consistent with these modes: both contacts are opened */
      *body = start, *frame = frame_before;
      body->on[0] = body->on[1] = 0.0;
      body->rates = (Rates){0.0, -gravity_at(scene, body->t), 0.0, {0}, {0}, {0}};
      integrate(scene, body, motion, piece, palms, frame, impulse);
    }
    left -= piece;
    for (int i = 0; i < CONTACTS; i++) {
      body->force[i] += impulse[i];
      if (body->mode[i] == 0.0 && body->on[i]) body->stuck_s[i] += piece;
    }
    if (resting[0] || resting[1]) {
      double slips[CONTACTS];
      slips_of(scene, body, frame, slips);
      for (int i = 0; i < CONTACTS; i++) resting[i] |= body->on[i] && body->mode[i] == 0.0;
      choose_modes(scene, body, palms, frame, body->t, resting);
    }
    settle(scene, body, palms, body->t);
  }
}

static void impact(const Scene *scene, Body *body, const Contact *at) {
  State *q = &body->state;
  const double j = 1.0 / scene->rho2;
  const double a11 = 1.0 + at[0].lever * at[0].lever * j, a22 = 1.0 + at[1].lever * at[1].lever * j;
  const double a12 = at[0].nx * at[1].nx + at[0].ny * at[1].ny + at[0].lever * at[1].lever * j;
  const double rate1 = at[0].rate, rate2 = at[1].rate;
  const double alone1 = fmax(-rate1 / a11, 0.0), alone2 = fmax(-rate2 / a22, 0.0);
  double p1, p2;
  if (!(body->on[0] && body->on[1])) {
    p1 = body->on[0] ? alone1 : 0.0, p2 = body->on[0] ? 0.0 : alone2;
  } else {
    const double det = a11 * a22 - a12 * a12;
    p1 = (a12 * rate2 - a22 * rate1) / det, p2 = (a12 * rate1 - a11 * rate2) / det;
    if (fmin(p1, p2) < 0.0 && fmin(rate1, rate2) < -scene->soft_blow) {
      const int first = p2 < p1;
      p1 = first ? alone1 : 0.0, p2 = first ? 0.0 : alone2;
    }
  }
  q->vx += p1 * at[0].nx + p2 * at[1].nx;
  q->vy += p1 * at[0].ny + p2 * at[1].ny;
  q->w += (p1 * at[0].lever + p2 * at[1].lever) * j;
}

/* Make the contacts consistent with gaps and forces, and compute the accelerations for the next step. */
static void settle(const Scene *scene, Body *body, const Palms *palms, double t) {
  const Frame frame = frame_of(scene, palms);
  Contact at[CONTACTS];
  double was_on[CONTACTS] = {body->on[0], body->on[1]};
  for (int i = 0; i < CONTACTS; i++) at[i] = contact_of(scene, i, &frame, &body->state, t, &body->theta[i]);
  const int hit1 = !body->on[0] && at[0].gap < 0.0, hit2 = !body->on[1] && at[1].gap < 0.0;
  if (hit1 || hit2) {
    body->on[0] = body->on[0] || hit1, body->on[1] = body->on[1] || hit2;
    const double a = body->on[0] ? -at[0].gap : 0.0, b = body->on[1] ? -at[1].gap : 0.0;
    const double det = at[0].nx * at[1].ny - at[0].ny * at[1].nx;
    body->state.x += (a * at[1].ny - b * at[0].ny) / det, body->state.y += (b * at[0].nx - a * at[1].nx) / det;
    impact(scene, body, at);
    for (int i = 0; i < CONTACTS; i++) {
      at[i] = contact_of(scene, i, &frame, &body->state, t, &body->theta[i]);
      body->on[i] = body->on[i] && at[i].rate <= scene->parting;
      if (body->on[i] && !was_on[i]) body->mode[i] = at[i].slip > 0.0 ? 1.0 : -1.0;
    }
  }
  Rates rates;
  if (!solve(scene, body, palms, &frame, &body->state, t, &rates)) rates = body->rates;
  while ((body->on[0] && rates.f[0] < 0.0) || (body->on[1] && rates.f[1] < 0.0)) {
    if (body->on[0] && (rates.f[0] <= rates.f[1] || !body->on[1]))
      body->on[0] = 0.0;
    else
      body->on[1] = 0.0;
    if (!solve(scene, body, palms, &frame, &body->state, t, &rates)) break;
  }
  int is_off = 0;
  for (int i = 0; i < CONTACTS; i++) {
    const Palm *palm = &scene->palms[i];
    /* on an arc |w| = s sinc(kappa s / 2); behind the hinge s is negative */
    const Support h = support_at(scene->table, body->theta[i]);
    const double c = cos(body->theta[i] + body->state.psi), s = sin(body->theta[i] + body->state.psi);
    const double out = h.h + palm->standoff, wx = body->state.x - frame.ox + out * c - h.first * s;
    const double wy = body->state.y - frame.oy + out * s + h.first * c;
    const double chord = hypot(wx, wy), half = 0.5 * fabs(palm->curvature);
    const double length = half * chord < 1e-9 ? chord : asin(fmin(half * chord, 1.0)) / half;
    body->s[i] = copysign(length, frame.along[i][0] * wx + frame.along[i][1] * wy), body->r[i] = h.h;
    if (body->on[i] && !(0.0 < body->s[i] && body->s[i] < palm->reach)) is_off = 1;
    body->least[i] = fmin(body->least[i], body->on[i] ? rates.f[i] : 0.0);
  }
  if (is_off || hypot(body->state.x - frame.ox, body->state.y - frame.oy) > scene->lost_distance) {
    body->fallen = 1.0, body->on[0] = body->on[1] = 0.0;
    rates = (Rates){0};
  }
  body->rates = rates;
}

static void stepped(const Scene *scene, Body *body, const Motion *motion, double dt) {
  const double t = body->t;
  const int pieces = (int)ceil(dt / scene->longest_step - 1e-9);
  Palms palms = palms_of(motion, t);
  Frame frame = frame_of(scene, &palms);
  for (int i = 0; i < CONTACTS; i++) body->force[i] = 0.0, body->least[i] = HUGE_VAL;
  for (int k = 0; k < pieces && !body->fallen; k++)
    go_on(scene, body, motion, (t + (k + 1) * dt / pieces) - body->t, &palms, &frame);
  body->t = t + dt;
  const double share = 1.0 - exp(-dt / scene->force_lag);
  for (int i = 0; i < CONTACTS; i++) {
    body->force[i] /= dt;
    body->slow[0][i] += share * (body->force[i] - body->slow[0][i]);
    body->slow[1][i] += share * (body->slow[0][i] - body->slow[1][i]);
  }
}

/* Initial state of a body that was placed: both contacts closed, slipping as the palms vibrate. */
void vibrating_plant_place(const Scene *scene, Body *body, const Palms *palms) {
  const Frame frame = frame_of(scene, palms);
  double slips[CONTACTS];
  for (int i = 0; i < CONTACTS; i++) body->on[i] = 1.0, body->preload[i] = 0.0, body->least[i] = HUGE_VAL;
  slips_of(scene, body, &frame, slips);
  for (int i = 0; i < CONTACTS; i++) body->mode[i] = slips[i] < 0.0 ? -1.0 : 1.0;
  Scene rigid = *scene; /* without friction: the forces are then about the mean ones with it */
  for (int i = 0; i < CONTACTS; i++) rigid.palms[i].yielding = rigid.palms[i].mu = 0.0;
  settle(&rigid, body, palms, body->t);
  for (int i = 0; i < CONTACTS; i++) {
    body->preload[i] = body->rates.f[i], body->force[i] = body->rates.f[i];
    body->slow[0][i] = body->slow[1][i] = body->rates.f[i];
  }
  settle(scene, body, palms, body->t);
}

void vibrating_plant_advance(const Scene *scene, Body *body, const Palms *middle, const Palms *end, double dt) {
  const Motion motion = {middle, end, body->t + dt, dt, 0};
  stepped(scene, body, &motion, dt);
}

/* Rows of a run, one before each step of `dt`; returns how many there are before a contact violates its bounds. */
long vibrating_plant_rock(const Scene *scene, Body *body, const Rocking *rocking, const ContactBounds *bounds, double dt,
                          Row *rows, long count) {
  const Motion motion = {.rocking = rocking};
  for (long k = 0; k < count; k++) {
    const Palms palms = palms_of(&motion, body->t);
    Row *row = &rows[k];
    *row = (Row){.t = k * dt, .psi = body->state.psi, .omega0 = body->state.w};
    for (int i = 0; i < CONTACTS; i++) {
      row->s[i] = body->s[i], row->r[i] = body->r[i], row->angles[i] = palms.angles[i];
      row->force[i] = bounds->mass * body->force[i];
      if (body->fallen || bounds->mass * body->least[i] < bounds->least ||
          !(bounds->low < row->s[i] && row->s[i] < bounds->high))
        return k;
    }
    stepped(scene, body, &motion, dt);
  }
  return count;
}
