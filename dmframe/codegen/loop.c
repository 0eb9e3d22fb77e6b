/* A run in plain C: what samples move, over the plant, or everything in continuous time (then DM_Z is 0).
   Above this stand the sizes DM_Z ... and the closed loop's own functions dm_constants, dm_trajectory, dm_sample, dm_rate,
   dm_clip. Arrays have one element more than they need, as C knows no empty ones. Nothing here allocates memory. */

typedef struct {
  double z[DM_Z + 1], u[DM_U + 1], w[DM_W + 1], y[DM_Y + 1], c[DM_C + 1];
} dm_work;

/* dx at time t, commands held. */
static void dm_slope(double t, const double *x, const double *p, dm_work *k, double *dx) {
  if (DM_MOVED) dm_trajectory(&t, p, k->c, k->w);
  dm_rate(x, k->u, k->w, p, k->c, dx);
}

#ifdef DM_STAGES
/* x from t to t + T by the Rosenbrock method whose numbers stand above: (3) of dmframe.diagram.rosenbrock. */
static void dm_integrate(double *x, double t, double h, int64_t substeps, const double *p, dm_work *k) {
  double u[DM_STAGES][DM_X + 1], at[DM_X + 1], right[DM_X + 1], drift[DM_X + 1], dw[DM_W + 1] = {0}, factors[DM_F + 1];
  for (int64_t j = 0; j < substeps; j++) {
    const double now = t + (double)j * h;
    if (DM_MOVED) dm_moving(&now, p, k->c, k->w, dw);
    dm_begin(x, k->u, k->w, dw, &h, p, k->c, factors, drift, u[0]);
    for (int s = 1; s < DM_STAGES; s++) {
      for (int i = 0; i < DM_X; i++) {
        at[i] = x[i];
        for (int r = 0; r < s; r++) at[i] += dm_method_a[s][r] * u[r][i];
      }
      dm_slope(now + dm_method_nodes[s] * h, at, p, k, right);
      for (int i = 0; i < DM_X; i++) {
        double sum = h * right[i] + dm_method_drifts[s] * h * h * drift[i];
        for (int r = 0; r < s; r++) sum += dm_method_c[s][r] * u[r][i];
        right[i] = dm_method_gamma * sum;
      }
      dm_solve(factors, right, p, k->c, u[s]);
    }
    for (int i = 0; i < DM_X; i++)
      for (int s = 0; s < DM_STAGES; s++) x[i] += dm_method_m[s] * u[s][i];
  }
}
#else
/* x from t to t + T by classical Runge-Kutta. */
static void dm_integrate(double *x, double t, double h, int64_t substeps, const double *p, dm_work *k) {
  double k1[DM_X + 1], k2[DM_X + 1], k3[DM_X + 1], k4[DM_X + 1], at[DM_X + 1];
  for (int64_t j = 0; j < substeps; j++) {
    const double now = t + (double)j * h;
    dm_slope(now, x, p, k, k1);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k1[i];
    dm_slope(now + h / 2, at, p, k, k2);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k2[i];
    dm_slope(now + h / 2, at, p, k, k3);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h * k3[i];
    dm_slope(now + h, at, p, k, k4);
    for (int i = 0; i < DM_X; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
}
#endif

static void dm_log(const double *state, const dm_work *k, const int64_t *kept, int64_t columns, double *row) {
  for (int64_t j = 0; j < columns; j++)
    row[j] = kept[j] < DM_Z + DM_X ? state[kept[j]] : k->y[kept[j] - (DM_Z + DM_X)];
}

/* Ticks first to first + ticks - 1; each has a row of `given`: its time, its length, and the DM_N numbers drawn for it. Of
   every `every`th tick, at its start, the `kept` numbers of (state, outputs) go to a row of `log`. Returns how many ticks
   ended with a state within `bounds`; it is left where the last one led. With no ticks at all, the row of `first` is
   written. */
DM_EXPORT int64_t dm_run(double *state, const double *p, double period, int64_t substeps, int64_t first, int64_t ticks,
                         const double *given, int64_t every, const int64_t *kept, int64_t columns, double *log,
                         const double *bounds) {
  dm_work k;
  dm_constants(p, k.c);
  if (ticks == 0) {
    dm_trajectory(given, p, k.c, k.w);
    dm_sample(state, k.w, given + 2, &period, p, k.c, k.z, k.u, k.y);
    dm_log(state, &k, kept, columns, log);
  }
  for (int64_t n = 0; n < ticks; n++, given += 2 + DM_N) {
    dm_trajectory(given, p, k.c, k.w);
    dm_sample(state, k.w, given + 2, &period, p, k.c, k.z, k.u, k.y);
    if ((first + n) % every == 0) {
      dm_log(state, &k, kept, columns, log);
      log += columns;
    }
    memcpy(state, k.z, DM_Z * sizeof *state);
    dm_integrate(state + DM_Z, given[0], given[1] / (double)substeps, substeps, p, &k);
    dm_clip(state + DM_Z, p, k.c, state + DM_Z);
    int sound = 1;
    for (int i = 0; i < DM_Z + DM_X; i++) sound &= fabs(state[i]) <= bounds[i];
    if (!sound) return n;
  }
  return ticks;
}
