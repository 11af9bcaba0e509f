/* One step of a body between two flat or bowed palms, the compiled equivalent of `rig.plant`, which describes the method;
   and a whole run on rocking palms, the equivalent of `rig.simulate`.

   The same operations in the same order, so that both give the same bits. There is no hidden state: `Step` holds
   everything that a step needs and returns. */

#include "plant.h"

typedef struct {
  double sagitta, standoff, reach;
} Pad;

typedef struct { /* of one body on one rig */
  const double (*table)[4]; /* h, h', h''/2, h'''/6 at each node */
  double rho2, mu, dither, damping, friction1, friction2, gravity, shake, shaking_hz[SHAKING], travel, base[2];
  double drift_rate, soft_blow, parting, lost_distance;
  Pad pads[2];
  long arc, bowed;
} Scene;

typedef struct {
  double c1, s1, c12, s12, out1, out2, w1, w12, al1, al12, ox, oy, vox, voy, aox, aoy, above1, above2;
} Frame;

typedef struct {
  double x, y, psi, vx, vy, w;
} State;

typedef struct {
  double ax, ay, al, f1, f2;
} Rates;

typedef struct {
  double slope, above;
} Plane;

typedef struct {
  State state;
  Rates rates;
  Frame frame;
  Plane planes[2];
  double on1, on2, fallen; /* 0 or 1 */
} Body;

typedef struct {
  Body body;
  double t; /* at its end */
  Palms middle, end;
  double dt;
} Step;

static Support at(const Scene *scene, double theta) { return support_at(scene->table, theta); }

static Frame frame_of(const Scene *scene, const Palms *palms, const Plane *planes) {
  double phi1 = palms->angles[0], phi2 = palms->angles[1], w1 = palms->rates[0], w2 = palms->rates[1];
  const double a1 = palms->accelerations[0], a2 = palms->accelerations[1];
  double c1 = cos(phi1), s1 = sin(phi1);
  Frame f = {.ox = scene->base[0], .oy = scene->base[1]};
  if (scene->arc) {
    const double length = scene->travel;
    f.ox -= length * c1, f.oy -= length * s1;
    f.vox = length * w1 * s1, f.voy = -length * w1 * c1;
    f.aox = length * (a1 * s1 + w1 * w1 * c1), f.aoy = length * (w1 * w1 * s1 - a1 * c1);
  }
  const double slope1 = planes[0].slope, phi12 = phi1 + phi2 - planes[1].slope;
  phi1 = phi1 + slope1;
  if (slope1 != 0.0) c1 = cos(phi1), s1 = sin(phi1);
  f.c1 = c1, f.s1 = s1, f.c12 = cos(phi12), f.s12 = sin(phi12);
  f.out1 = phi1 - 0.5 * PI, f.out2 = phi12 + 0.5 * PI;
  f.w1 = w1, f.w12 = w1 + w2, f.al1 = a1, f.al12 = a1 + a2;
  f.above1 = planes[0].above, f.above2 = planes[1].above;
  return f;
}

static void distances(const Scene *scene, const Frame *f, const State *q, double *s) {
  const double rx = q->x - f->ox, ry = q->y - f->oy;
  s[0] = f->c1 * rx + f->s1 * ry + at(scene, f->out1 - q->psi).first;
  s[1] = f->c12 * rx + f->s12 * ry - at(scene, f->out2 - q->psi).first;
}

static void follow_the_surfaces(const Scene *scene, Body *body) {
  double s[2];
  distances(scene, &body->frame, &body->state, s);
  for (int i = 0; i < 2; i++) {
    const Pad *pad = &scene->pads[i];
    const double u = fmin(fmax(s[i], 0.0), pad->reach) / pad->reach;
    body->planes[i].slope = 4.0 * pad->sagitta / pad->reach * (1.0 - 2.0 * u);
    body->planes[i].above = pad->standoff + 4.0 * pad->sagitta * u * u;
  }
}

static double gravity_at(const Scene *scene, double t) {
  if (scene->shake == 0.0) return scene->gravity;
  double swings = 0.0;
  for (int i = 0; i < SHAKING; i++) swings += sin(TAU * scene->shaking_hz[i] * t);
  return scene->gravity + scene->shake * swings;
}

static double friction(const Scene *scene, double slip) {
  if (scene->mu == 0.0) return 0.0;
  return scene->mu * slip / sqrt(slip * slip + scene->dither * scene->dither);
}

static Rates solve(const Scene *scene, const Body *body, double t, const Frame *f, State q) {
  const double c1 = f->c1, s1 = f->s1, c12 = f->c12, s12 = f->s12, w1 = f->w1, w12 = f->w12, w = q.w;
  const double g = gravity_at(scene, t), rho2 = scene->rho2, damping = -scene->damping * w / rho2;
  const double rx = q.x - f->ox, ry = q.y - f->oy, ux = q.vx - f->vox, uy = q.vy - f->voy;
  const double gx = -f->aox, gy = -g - f->aoy;
  double b1 = 0.0, f1x = 0.0, f1y = 0.0, m1 = 0.0, b2 = 0.0, f2x = 0.0, f2y = 0.0, m2 = 0.0;
  Support one = {0}, two = {0};
  if (body->on1) {
    one = at(scene, f->out1 - q.psi);
    const double along = c1 * rx + s1 * ry, normal = c1 * ry - s1 * rx, spin = w1 - w;
    const double rate = c1 * uy - s1 * ux - w1 * along - one.first * spin;
    b1 = c1 * gy - s1 * gx - 2.0 * w1 * (c1 * ux + s1 * uy) - f->al1 * along - w1 * w1 * normal -
         one.second * spin * spin - one.first * (f->al1 - damping) +
         scene->drift_rate * (2.0 * rate + scene->drift_rate * (normal - one.h - f->above1));
    const double k1 = scene->friction1 * friction(scene, c1 * ux + s1 * uy + w * one.h + w1 * (normal - one.h));
    f1x = -s1 - k1 * c1, f1y = c1 - k1 * s1, m1 = one.first - k1 * one.h;
  }
  if (body->on2) {
    two = at(scene, f->out2 - q.psi);
    const double along = c12 * rx + s12 * ry, normal = s12 * rx - c12 * ry, spin = w12 - w;
    const double rate = s12 * ux - c12 * uy + w12 * along - two.first * spin;
    b2 = s12 * gx - c12 * gy + 2.0 * w12 * (c12 * ux + s12 * uy) + f->al12 * along - w12 * w12 * normal -
         two.second * spin * spin - two.first * (f->al12 - damping) +
         scene->drift_rate * (2.0 * rate + scene->drift_rate * (normal - two.h - f->above2));
    const double k2 = scene->friction2 * friction(scene, -c12 * ux - s12 * uy + w * two.h + w12 * (normal - two.h));
    f2x = s12 + k2 * c12, f2y = -c12 + k2 * s12, m2 = two.first - k2 * two.h;
  }
  Rates r = {0.0, -g, damping, 0.0, 0.0};
  if (body->on1 && body->on2) {
    const double a11 = 1.0 + one.first * m1 / rho2, a22 = 1.0 + two.first * m2 / rho2;
    const double a12 = c1 * f2y - s1 * f2x + one.first * m2 / rho2, a21 = s12 * f1x - c12 * f1y + two.first * m1 / rho2;
    const double det = a11 * a22 - a12 * a21;
    r.f1 = (a12 * b2 - a22 * b1) / det, r.f2 = (a21 * b1 - a11 * b2) / det;
    r.ax = r.f1 * f1x + r.f2 * f2x, r.ay = r.ay + r.f1 * f1y + r.f2 * f2y, r.al = r.al + (r.f1 * m1 + r.f2 * m2) / rho2;
  } else if (body->on1) {
    r.f1 = -b1 / (1.0 + one.first * m1 / rho2);
    r.ax = r.f1 * f1x, r.ay = r.ay + r.f1 * f1y, r.al = r.al + r.f1 * m1 / rho2;
  } else if (body->on2) {
    r.f2 = -b2 / (1.0 + two.first * m2 / rho2);
    r.ax = r.f2 * f2x, r.ay = r.ay + r.f2 * f2y, r.al = r.al + r.f2 * m2 / rho2;
  }
  return r;
}

static void gap_rates(const Scene *scene, const Frame *f, const State *q, double *rates) {
  const double rx = q->x - f->ox, ry = q->y - f->oy, ux = q->vx - f->vox, uy = q->vy - f->voy;
  rates[0] = f->c1 * uy - f->s1 * ux - f->w1 * (f->c1 * rx + f->s1 * ry) -
             at(scene, f->out1 - q->psi).first * (f->w1 - q->w);
  rates[1] = f->s12 * ux - f->c12 * uy + f->w12 * (f->c12 * rx + f->s12 * ry) -
             at(scene, f->out2 - q->psi).first * (f->w12 - q->w);
}

static void impact(const Scene *scene, Body *body) {
  State *q = &body->state;
  const Frame *f = &body->frame;
  const double n1x = -f->s1, n1y = f->c1, n2x = f->s12, n2y = -f->c12, j = 1.0 / scene->rho2;
  const double d1 = at(scene, f->out1 - q->psi).first, d2 = at(scene, f->out2 - q->psi).first;
  const double a11 = 1.0 + d1 * d1 * j, a22 = 1.0 + d2 * d2 * j, a12 = n1x * n2x + n1y * n2y + d1 * d2 * j;
  double rate[2], p1, p2;
  gap_rates(scene, f, q, rate);
  const double alone1 = fmax(-rate[0] / a11, 0.0), alone2 = fmax(-rate[1] / a22, 0.0);
  if (!(body->on1 && body->on2)) {
    p1 = body->on1 ? alone1 : 0.0, p2 = body->on1 ? 0.0 : alone2;
  } else {
    const double det = a11 * a22 - a12 * a12;
    p1 = (a12 * rate[1] - a22 * rate[0]) / det, p2 = (a12 * rate[0] - a11 * rate[1]) / det;
    if (fmin(p1, p2) < 0.0 && fmin(rate[0], rate[1]) < -scene->soft_blow) {
      const int first = p2 < p1;
      p1 = first ? alone1 : 0.0, p2 = first ? 0.0 : alone2;
    }
  }
  q->vx += p1 * n1x + p2 * n2x;
  q->vy += p1 * n1y + p2 * n2y;
  q->w += (p1 * d1 + p2 * d2) * j;
  gap_rates(scene, f, q, rate);
  body->on1 = body->on1 && rate[0] <= scene->parting;
  body->on2 = body->on2 && rate[1] <= scene->parting;
}

static void close_gaps(const Scene *scene, Body *body) {
  State *q = &body->state;
  const Frame *f = &body->frame;
  if (body->on1 && body->on2) return;
  const double rx = q->x - f->ox, ry = q->y - f->oy;
  const double gap1 = f->c1 * ry - f->s1 * rx - at(scene, f->out1 - q->psi).h - f->above1;
  const double gap2 = f->s12 * rx - f->c12 * ry - at(scene, f->out2 - q->psi).h - f->above2;
  const int hit1 = !body->on1 && gap1 < 0.0, hit2 = !body->on2 && gap2 < 0.0;
  if (!(hit1 || hit2)) return;
  body->on1 = body->on1 || hit1, body->on2 = body->on2 || hit2;
  const double a = body->on1 ? -gap1 : 0.0, b = body->on2 ? -gap2 : 0.0, sin_phi2 = f->c1 * f->s12 - f->s1 * f->c12;
  q->x = q->x + (a * f->c12 + b * f->c1) / sin_phi2;
  q->y = q->y + (a * f->s12 + b * f->s1) / sin_phi2;
  impact(scene, body);
}

static void settle_contacts(const Scene *scene, Body *body, double t) {
  close_gaps(scene, body);
  Rates rates = solve(scene, body, t, &body->frame, body->state);
  while ((body->on1 && rates.f1 < 0.0) || (body->on2 && rates.f2 < 0.0)) {
    if (body->on1 && (rates.f1 <= rates.f2 || !body->on2))
      body->on1 = 0.0;
    else
      body->on2 = 0.0;
    rates = solve(scene, body, t, &body->frame, body->state);
  }
  double s[2];
  distances(scene, &body->frame, &body->state, s);
  const int off1 = body->on1 && !(0.0 < s[0] && s[0] < scene->pads[0].reach);
  const int off2 = body->on2 && !(0.0 < s[1] && s[1] < scene->pads[1].reach);
  if (off1 || off2 || hypot(body->state.x - body->frame.ox, body->state.y - body->frame.oy) > scene->lost_distance) {
    body->fallen = 1.0, body->on1 = body->on2 = 0.0;
    rates = (Rates){0};
  }
  body->rates = rates;
}

void plant_advance(const Scene *scene, Step *step) {
  Body *body = &step->body;
  const double dt = step->dt, half = 0.5 * dt, sixth = dt / 6.0, t = step->t;
  if (scene->bowed) follow_the_surfaces(scene, body);
  const Frame middle = frame_of(scene, &step->middle, body->planes), last = frame_of(scene, &step->end, body->planes);
  const State q = body->state;
  const Rates r1 = body->rates;
  const double vx2 = q.vx + half * r1.ax, vy2 = q.vy + half * r1.ay, w2 = q.w + half * r1.al;
  const State q2 = {q.x + half * q.vx, q.y + half * q.vy, q.psi + half * q.w, vx2, vy2, w2};
  const Rates r2 = solve(scene, body, t, &middle, q2);
  const double vx3 = q.vx + half * r2.ax, vy3 = q.vy + half * r2.ay, w3 = q.w + half * r2.al;
  const State q3 = {q.x + half * vx2, q.y + half * vy2, q.psi + half * w2, vx3, vy3, w3};
  const Rates r3 = solve(scene, body, t, &middle, q3);
  const double vx4 = q.vx + dt * r3.ax, vy4 = q.vy + dt * r3.ay, w4 = q.w + dt * r3.al;
  const State q4 = {q.x + dt * vx3, q.y + dt * vy3, q.psi + dt * w3, vx4, vy4, w4};
  const Rates r4 = solve(scene, body, t, &last, q4);
  body->state = (State){
      q.x + sixth * (q.vx + 2.0 * (vx2 + vx3) + vx4),
      q.y + sixth * (q.vy + 2.0 * (vy2 + vy3) + vy4),
      q.psi + sixth * (q.w + 2.0 * (w2 + w3) + w4),
      q.vx + sixth * (r1.ax + 2.0 * (r2.ax + r3.ax) + r4.ax),
      q.vy + sixth * (r1.ay + 2.0 * (r2.ay + r3.ay) + r4.ay),
      q.w + sixth * (r1.al + 2.0 * (r2.al + r3.al) + r4.al),
  };
  body->frame = last;
  settle_contacts(scene, body, t);
}

/* Rows of a run, one before each step of `step->dt`; returns how many there are before a contact violates its bounds. */
long plant_rock(const Scene *scene, Step *step, const Rocking *rocking, const ContactBounds *bounds, Row *rows,
                long count) {
  const Body *body = &step->body;
  const double dt = step->dt;
  step->end = palms_at(rocking, -rocking->lag);
  for (long k = 0; k < count; k++) {
    const double t = k * dt, psi = body->state.psi;
    Row *row = &rows[k];
    *row = (Row){.t = t, .psi = psi, .omega0 = body->state.w};
    distances(scene, &body->frame, &body->state, row->s);
    row->r[0] = at(scene, body->frame.out1 - psi).h, row->r[1] = at(scene, body->frame.out2 - psi).h;
    row->force[0] = bounds->mass * body->rates.f1, row->force[1] = bounds->mass * body->rates.f2;
    for (int i = 0; i < 2; i++) {
      row->angles[i] = step->end.angles[i];
      if (row->force[i] < bounds->least || !(bounds->low < row->s[i] && row->s[i] < bounds->high)) return k;
    }
    step->middle = palms_at(rocking, t + 0.5 * dt - rocking->lag);
    step->end = palms_at(rocking, t + dt - rocking->lag);
    step->t += dt;
    plant_advance(scene, step);
  }
  return count;
}
