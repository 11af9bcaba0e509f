/* Vectors and row-major rotation matrices, as in `model.rotation`. */

#include <math.h>

static inline void cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline double sinc(double angle) { return angle == 0.0 ? 1.0 : sin(angle) / angle; }

/* to = exp[v] R; `to` must not alias R */
static inline void turned(const double *v, const double *R, double *to) {
  const double square = dot(v, v), angle = sqrt(square), first = sinc(angle), half = sinc(angle / 2);
  const double S[3][3] = {{0, -v[2], v[1]}, {v[2], 0, -v[0]}, {-v[1], v[0], 0}};
  for (int i = 0; i < 3; i++) {
    double E[3];
    for (int j = 0; j < 3; j++)
      E[j] = (i == j) + first * S[i][j] + half * half / 2 * (v[i] * v[j] - (i == j) * square);
    for (int j = 0; j < 3; j++) to[3 * i + j] = E[0] * R[j] + E[1] * R[3 + j] + E[2] * R[6 + j];
  }
}
