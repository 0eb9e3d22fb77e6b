/* DM_WIDTH twins at a time: a servo and a robot follow the commands of a log; included after simd.h, the functions dm_begin,
   dm_rate and dm_implicit of the twin, and the coefficients of the method. The twin is the last index of every array. */

#define DM_BOUND 1e3

/* One step of the Rosenbrock method of dmframe.diagram.rosenbrock, equation (3), with A = -M^-1 K in the rows of dq. */
static void dm_twin_step(dm_real *x, const dm_real *u, const dm_real *p, dm_real h) {
  dm_real S[DM_N * DM_N], f[DM_X], at[DM_X], stage[DM_STAGES][DM_X];
  dm_rate(x, u, p, f);
  dm_implicit(x, p, &h, f, S);
  for (int s = 0; s < DM_STAGES; s++) {
    memcpy(at, x, sizeof at);
    for (int j = 0; j < s; j++)
      for (int i = 0; i < DM_X; i++) at[i] += dm_a[s][j] * stage[j][i];
    if (s > 0) dm_rate(at, u, p, f);
    for (int i = 0; i < DM_X; i++) {
      f[i] *= h;
      for (int j = 0; j < s; j++) f[i] += dm_c[s][j] * stage[j][i];
      stage[s][i] = DM_GAMMA * f[i];
    }
    for (int i = 0; i < DM_N; i++) {
      dm_real sum = dm_all(0);
      for (int j = 0; j < DM_N; j++) sum += S[i + DM_N * j] * f[DM_N + j];
      stage[s][DM_N + i] = DM_GAMMA * sum;
    }
  }
  for (int s = 0; s < DM_STAGES; s++)
    for (int i = 0; i < DM_X; i++) x[i] += dm_m[s] * stage[s][i];
}

DM_EXPORT void dm_width(double *count) { *count = DM_WIDTH; }

/* Positions q at the samples of a log. A segment has a constant command, row `command` of `commands`, to which `gain` times the
   number `slot` of the twin's unknown commands is added, unless the slot is -1, and a length that is
   affine in the twin's delay: length + slope times its row `DM_DELAY` of p. `record` is the sample at the end of a segment, or
   -1. A twin that leaves the bound starts again, and its positions from there on are NaN. */
DM_EXPORT void dm_twin(const double *parameters, const double *commands, const int64_t *slot, const double *gain,
                       int64_t segments, const double *length, const double *slope, const int64_t *command, const int64_t *steps,
                       const int64_t *record, double *q) {
  dm_real p[DM_P], x[DM_X], fresh[DM_X], u[DM_N];
  memcpy(p, parameters, sizeof p);
  dm_begin(p, fresh);
  memcpy(x, fresh, sizeof x);
  dm_mask alive = dm_all(0) == dm_all(0);
  for (int64_t k = 0; k < segments; k++) {
    for (int i = 0; i < DM_N; i++) {
      const int64_t cell = command[k] * DM_N + i;
      u[i] = dm_all(commands[cell]);
      if (slot[cell] >= 0) u[i] += gain[cell] * p[DM_COMMAND + slot[cell]];
    }
    const dm_real h = (length[k] + slope[k] * p[DM_DELAY]) / (double)steps[k];
    for (int64_t j = 0; j < steps[k]; j++) dm_twin_step(x, u, p, h);
    dm_mask sound = alive;
    for (int i = 0; i < 2 * DM_N; i++) sound &= (dm_mask)(dm_abs(x[i]) <= DM_BOUND); /* q and dq: torques are larger */
    alive = sound;
    if (dm_any(~alive)) {
      for (int i = 0; i < DM_X; i++) x[i] = dm_choose(alive, x[i], fresh[i]);
      if (!dm_any(alive)) {
        for (int64_t r = k; r < segments; r++)
          if (record[r] >= 0)
            for (int i = 0; i < DM_N * DM_WIDTH; i++) q[record[r] * DM_N * DM_WIDTH + i] = NAN;
        return;
      }
    }
    if (record[k] >= 0)
      for (int i = 0; i < DM_N; i++) {
        const dm_real shown = dm_choose(alive, x[i], dm_all(NAN));
        memcpy(q + (record[k] * DM_N + i) * DM_WIDTH, &shown, sizeof shown);
      }
  }
}
