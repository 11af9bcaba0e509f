/* Roll out sequences of palm moves with the generated kernels `begin_batch`, `roll_batch`, and summarise each move.

   The counterpart of `motion.rollout_predictor`, which documents the results. Eight sequences run side by side; when one
   ends the next takes its column, so that no column of the kernel is idle. */

#include <math.h>
#include <stdint.h>

#define LANES 8
#define NODE 2 /* psi, omega0 */
#define CONTACTS 2 /* s1, s2 */
#define MOVE 6
#define SUBSTEPS 4
#define OUTPUTS 10 /* psi, omega0, f1, f2 (smallest within a vibration), s1, s2, f1, f2 (mean), theta1, theta2 */
#define S 4 /* index of s1 in the outputs */
#define THETA 8 /* index of theta1 */
#define BINS 72
#define MOST_MOVES 16
#define STATE 21
#define STEP_S 0.01
#define CALL_S (SUBSTEPS * STEP_S)
#define CLOSE 1e-9

const long rollout_sizes[] = {LANES, STATE, MOVE, SUBSTEPS, OUTPUTS, BINS, MOST_MOVES};

void kernel_begin_batch(const double *const *in, double *const *out, long columns);
void kernel_roll_batch(const double *const *in, double *const *out, long columns);

typedef struct {
  const double *states, *points, *durations, *rig; /* (n, STATE), (n, k + 1, 2), (n, k) */
  double elapsed, horizon;
  long n, k, calls; /* calls: rows of the path */
  uint8_t *touched; /* (n, k, BINS) */
  double *force, *nearest, *farthest, *psi, *omega0; /* (n, k) */
  double *path; /* (n, calls, OUTPUTS) */
} Task;

typedef struct {
  long sequence, call, calls, leg;
  double finished[MOST_MOVES]; /* when each move ends, in the sequence's time */
  long last[MOST_MOVES];       /* last step of each move */
} Lane;

static Lane begin_lane(const Task *task, long sequence) {
  Lane lane = {.sequence = sequence};
  double t = 0.0;
  for (long j = 0; j < task->k; j++) lane.finished[j] = (t += task->durations[sequence * task->k + j]) - task->elapsed;
  const double end = lane.finished[task->k - 1];
  const long calls = (long)ceil(((end < task->horizon ? end : task->horizon) - CLOSE) / CALL_S);
  lane.calls = calls > 1 ? calls : 1;
  for (long j = 0; j < task->k; j++) {
    const long last = (long)ceil(lane.finished[j] / STEP_S - CLOSE) - 1, most = lane.calls * SUBSTEPS - 1;
    lane.last[j] = last < 0 ? 0 : last > most ? most : last;
  }
  return lane;
}

/* minimum and maximum that propagate NaN, as in NumPy */
static double lower(double a, double b) { return a < b || a != a ? a : b; }
static double higher(double a, double b) { return a > b || a != a ? a : b; }

static int bin_of(double theta) {
  double turned = isfinite(theta) ? fmod(theta, 2 * M_PI) : 0.0;
  if (turned < 0.0) turned += 2 * M_PI;
  return (int)floor(turned / (2 * M_PI / BINS)) % BINS;
}

static void judge(const Task *task, const Lane *lane, const double outputs[SUBSTEPS][OUTPUTS]) {
  const long k = task->k, row = lane->sequence * k + lane->leg;
  const double end = lane->finished[k - 1];
  for (int i = 0; i < SUBSTEPS; i++) {
    const double *now = outputs[i];
    const long step = lane->call * SUBSTEPS + i;
    if (step * STEP_S < end - CLOSE) {
      const double force = lower(now[2], now[3]);
      task->force[row] = lower(task->force[row], isfinite(force) ? force : -INFINITY);
      task->nearest[row] = lower(task->nearest[row], lower(now[4], now[5]));
      task->farthest[row] = higher(task->farthest[row], higher(now[4], now[5]));
      for (int contact = 0; contact < 2; contact++) task->touched[row * BINS + bin_of(now[THETA + contact])] = 1;
    }
    for (long j = 0; j < k; j++) {
      if (lane->last[j] != step) continue;
      task->psi[lane->sequence * k + j] = now[0];
      task->omega0[lane->sequence * k + j] = now[1];
    }
  }
  for (int i = 0; i < OUTPUTS; i++)
    task->path[(lane->sequence * task->calls + lane->call) * OUTPUTS + i] = outputs[SUBSTEPS - 1][i];
}

/* accumulate the results of the moves, so that each covers the time since the beginning */
static void accumulate(const Task *task, const Lane *lane) {
  const long k = task->k;
  for (long j = 0; j < k; j++) {
    const long row = lane->sequence * k + j;
    if (lane->finished[j] > lane->calls * SUBSTEPS * STEP_S + CLOSE) task->force[row] = -INFINITY;
    if (j == 0) continue;
    task->force[row] = lower(task->force[row], task->force[row - 1]);
    task->nearest[row] = lower(task->nearest[row], task->nearest[row - 1]);
    task->farthest[row] = higher(task->farthest[row], task->farthest[row - 1]);
    for (int bin = 0; bin < BINS; bin++) task->touched[row * BINS + bin] |= task->touched[(row - 1) * BINS + bin];
  }
}

void roll_sequences(const Task *task) {
  double x[LANES][STATE] = {{0}}, move[LANES][MOVE] = {{0}}, moved[LANES][NODE], outputs[LANES][SUBSTEPS][OUTPUTS];
  double s[LANES][CONTACTS] = {{0}}, found[LANES][CONTACTS];
  const double *where[] = {&x[0][0], &move[0][0], task->rig}, *in[] = {&x[0][0], &s[0][0], &move[0][0], task->rig};
  double *there[] = {&found[0][0]}, *out[] = {&moved[0][0], &outputs[0][0][0]};
  Lane lanes[LANES];
  long next = 0, busy = 0;
  for (int l = 0; l < LANES; l++) {
    lanes[l].sequence = -1;
    move[l][4] = 1.0;
  }
  do {
    int fresh[LANES] = {0}, any = 0;
    busy = 0;
    for (int l = 0; l < LANES; l++) {
      Lane *lane = &lanes[l];
      if (lane->sequence < 0 && next < task->n) {
        *lane = begin_lane(task, next);
        for (int i = 0; i < STATE; i++) x[l][i] = task->states[next * STATE + i];
        next++;
        fresh[l] = any = 1;
      }
      if (lane->sequence < 0) continue;
      busy++;
      const double t = lane->call * CALL_S, *durations = task->durations + lane->sequence * task->k;
      while (lane->leg < task->k - 1 && lane->finished[lane->leg] <= t + CLOSE) lane->leg++;
      const double *points = task->points + (lane->sequence * (task->k + 1) + lane->leg) * 2;
      for (int i = 0; i < 4; i++) move[l][i] = points[i];
      move[l][4] = durations[lane->leg];
      move[l][5] = t - (lane->finished[lane->leg] - durations[lane->leg]);
    }
    if (!busy) break;
    if (any) kernel_begin_batch(where, there, LANES);
    for (int l = 0; l < LANES; l++)
      if (fresh[l])
        for (int i = 0; i < CONTACTS; i++) s[l][i] = found[l][i];
    kernel_roll_batch(in, out, LANES);
    for (int l = 0; l < LANES; l++) {
      Lane *lane = &lanes[l];
      if (lane->sequence < 0) continue;
      judge(task, lane, (const double(*)[OUTPUTS])outputs[l]);
      for (int i = 0; i < NODE; i++) x[l][i] = moved[l][i];
      for (int i = 0; i < CONTACTS; i++) s[l][i] = outputs[l][SUBSTEPS - 1][S + i];
      if (++lane->call < lane->calls) continue;
      accumulate(task, lane);
      lane->sequence = -1;
    }
  } while (1);
}
