/* Shared by both plants in C: a support function's table, and rocking palms as in `rig.simulate`. */

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
