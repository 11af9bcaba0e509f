/* Rauch–Tung–Striebel smoother for the palms' motion over a whole record: the twin of `observer.palm_path`.

   States of a report: φ, ω, α (3) of each joint (JOINTS), joints side by side. Covariances are those of one joint, the
   same for all. */

#include <math.h>
#include <string.h>

#define JOINTS 2
#define STATES 3

const long palm_path_sizes[] = {STATES, JOINTS};

typedef double Matrix[STATES][STATES];

/* gain = P_pred⁻¹ FP, by Cholesky's factor of P_pred; transposed */
static void gain_of(const Matrix P_pred, const Matrix FP, Matrix gain) {
  Matrix L;
  for (int i = 0; i < STATES; i++)
    for (int j = 0; j <= i; j++) {
      double a = P_pred[i][j];
      for (int k = 0; k < j; k++) a -= L[i][k] * L[j][k];
      L[i][j] = i == j ? sqrt(a) : a / L[j][j];
    }
  for (int c = 0; c < STATES; c++) {
    double *y = gain[c];
    for (int i = 0; i < STATES; i++) {
      y[i] = FP[i][c];
      for (int k = 0; k < i; k++) y[i] -= L[i][k] * y[k];
      y[i] /= L[i][i];
    }
    for (int i = STATES - 1; i >= 0; i--) {
      for (int k = i + 1; k < STATES; k++) y[i] -= L[k][i] * y[k];
      y[i] /= L[i][i];
    }
  }
}

/* fuse one report, (STATES, JOINTS), NaN where not reported; `sd` of each row */
static void fuse(double (*x)[JOINTS], Matrix P, const double *report, const double *sd) {
  for (int row = 0; row < STATES; row++) {
    const double *values = report + row * JOINTS;
    if (isnan(values[0])) continue;
    double gain[STATES], miss[JOINTS];
    const double spread = P[row][row] + sd[row] * sd[row];
    for (int i = 0; i < STATES; i++) gain[i] = P[i][row] / spread;
    for (int j = 0; j < JOINTS; j++) miss[j] = values[j] - x[row][j];
    for (int i = 0; i < STATES; i++) {
      for (int j = 0; j < JOINTS; j++) x[i][j] += gain[i] * miss[j];
      for (int k = 0; k < STATES; k++) P[i][k] -= gain[i] * gain[k] * spread;
    }
  }
}

/* `step` (n − 1): time from one report to the next; `drift` (n − 1, 3, 3): process noise covariance of it. `reports`
   (n, STATES, JOINTS). `first`: initial variances. Result in x (n, 3, JOINTS); `predicted` and `gains`, (n, 3, JOINTS) and
   (n, 3, 3), are work arrays. */
void smooth_path(long n, const double *step, const Matrix *drift, const double *reports, const double *sd,
                 const double *first, double (*x)[STATES][JOINTS], double (*predicted)[STATES][JOINTS], Matrix *gains) {
  Matrix P = {{0.0}};
  for (int i = 0; i < STATES; i++) P[i][i] = first[i];
  memset(x[0], 0, sizeof x[0]);
  memcpy(x[0][0], reports, sizeof x[0][0]);
  fuse(x[0], P, reports, sd);
  for (long k = 1; k < n; k++) {
    const double dt = step[k - 1], half = dt * dt / 2;
    Matrix FP, P_pred;
    for (int c = 0; c < STATES; c++) {
      FP[0][c] = P[0][c] + dt * P[1][c] + half * P[2][c];
      FP[1][c] = P[1][c] + dt * P[2][c];
      FP[2][c] = P[2][c];
    }
    for (int i = 0; i < STATES; i++) {
      P_pred[i][0] = FP[i][0] + dt * FP[i][1] + half * FP[i][2] + drift[k - 1][i][0];
      P_pred[i][1] = FP[i][1] + dt * FP[i][2] + drift[k - 1][i][1];
      P_pred[i][2] = FP[i][2] + drift[k - 1][i][2];
    }
    gain_of(P_pred, FP, gains[k - 1]);
    for (int j = 0; j < JOINTS; j++) {
      predicted[k][0][j] = x[k - 1][0][j] + dt * x[k - 1][1][j] + half * x[k - 1][2][j];
      predicted[k][1][j] = x[k - 1][1][j] + dt * x[k - 1][2][j];
      predicted[k][2][j] = x[k - 1][2][j];
    }
    memcpy(P, P_pred, sizeof P);
    memcpy(x[k], predicted[k], sizeof x[k]);
    fuse(x[k], P, reports + k * STATES * JOINTS, sd);
  }
  for (long k = n - 2; k >= 0; k--)
    for (int j = 0; j < JOINTS; j++) {
      double miss[STATES];
      for (int i = 0; i < STATES; i++) miss[i] = x[k + 1][i][j] - predicted[k + 1][i][j];
      for (int i = 0; i < STATES; i++)
        for (int c = 0; c < STATES; c++) x[k][i][j] += gains[k][i][c] * miss[c];
    }
}
