/* A robot and its servo between two cycles of the controller: constant command, RK4 integration. */

DM_EXPORT void dm_prepare(const double *p, double *c) { dm_constants(p, c); }

DM_EXPORT void dm_show(const double *x, const double *p, const double *c, double *y) { dm_measured(x, p, c, y); }

/* Returns 0, and leaves the state unchanged, if the new state is not finite. */
DM_EXPORT int dm_move(double *state, const double *u, const double *step, const double *count, const double *p,
                      const double *c) {
  const double h = *step;
  double k1[DM_X], k2[DM_X], k3[DM_X], k4[DM_X], at[DM_X], x[DM_X], gap = 0;
  memcpy(x, state, sizeof x);
  for (int j = 0; j < (int)*count; j++) {
    dm_rate(x, u, p, c, k1);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k1[i];
    dm_rate(at, u, p, c, k2);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h / 2 * k2[i];
    dm_rate(at, u, p, c, k3);
    for (int i = 0; i < DM_X; i++) at[i] = x[i] + h * k3[i];
    dm_rate(at, u, p, c, k4);
    for (int i = 0; i < DM_X; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
  for (int i = 0; i < DM_X; i++) gap += x[i] - x[i];
  if (gap != 0) return 0;
  memcpy(state, x, sizeof x);
  return 1;
}
