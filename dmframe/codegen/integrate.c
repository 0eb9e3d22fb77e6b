/* Integrators from one tick to the next. Numbers are of type dm_real: a double, or a vector with one element for each run.
   Runs of a vector may take different numbers of steps; a run keeps its state after its own steps. The sizes DM_Z ... and
   the functions of the closed loop precede this file. Arrays have one element more than needed, since C has no empty
   arrays. No memory is allocated. */

typedef struct {
  dm_real z[DM_Z + 1], u[DM_U + 1], w[DM_W + 1], y[DM_Y + 1], c[DM_C + 1];
} dm_work;

/* dx at time t, with constant commands. */
static void dm_slope(dm_real t, const dm_real *x, const dm_real *p, dm_work *k, dm_real *dx) {
  if (DM_MOVED) dm_trajectory(&t, p, k->c, k->w);
  dm_rate(x, k->u, k->w, p, k->c, dx);
}

#ifdef DM_STAGES
/* x from t to t + T by the Rosenbrock method of the coefficients above: (3) of dmframe.diagram.rosenbrock. */
static void dm_integrate(dm_real *x, double t, dm_real h, dm_steps substeps, const dm_real *p, dm_work *k) {
  dm_real u[DM_STAGES][DM_X + 1], at[DM_X + 1], right[DM_X + 1], drift[DM_X + 1], dw[DM_W + 1] = {0}, factors[DM_F + 1];
  for (int64_t j = 0; j < dm_most(substeps); j++) {
    const dm_real now = t + (double)j * h;
    if (DM_MOVED) dm_moving(&now, p, k->c, k->w, dw);
    dm_begin(x, k->u, k->w, dw, &h, p, k->c, factors, drift, u[0]);
    for (int s = 1; s < DM_STAGES; s++) {
      for (int i = 0; i < DM_X; i++) {
        at[i] = x[i];
        for (int r = 0; r < s; r++) at[i] += dm_method_a[s][r] * u[r][i];
      }
      dm_slope(now + dm_method_nodes[s] * h, at, p, k, right);
      for (int i = 0; i < DM_X; i++) {
        dm_real sum = h * right[i] + dm_method_drifts[s] * h * h * drift[i];
        for (int r = 0; r < s; r++) sum += dm_method_c[s][r] * u[r][i];
        right[i] = dm_method_gamma * sum;
      }
      dm_solve(factors, right, p, k->c, u[s]);
    }
    for (int i = 0; i < DM_X; i++) {
      dm_real next = x[i];
      for (int s = 0; s < DM_STAGES; s++) next += dm_method_m[s] * u[s][i];
      x[i] = dm_before(j, substeps, next, x[i]);
    }
  }
}
#else
/* x from t to t + T by classical Runge-Kutta. */
static void dm_integrate(dm_real *x, double t, dm_real h, dm_steps substeps, const dm_real *p, dm_work *k) {
  dm_real k1[DM_X + 1], k2[DM_X + 1], k3[DM_X + 1], k4[DM_X + 1], at[DM_X + 1];
  for (int64_t j = 0; j < dm_most(substeps); j++) {
    const dm_real now = t + (double)j * h;
    dm_slope(now, x, p, k, k1);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k1[i];
    dm_slope(now + h / 2, at, p, k, k2);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k2[i];
    dm_slope(now + h / 2, at, p, k, k3);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h * k3[i];
    dm_slope(now + h, at, p, k, k4);
    for (int i = 0; i < DM_X; i++)
      x[i] = dm_before(j, substeps, x[i] + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]), x[i]);
  }
}
#endif
