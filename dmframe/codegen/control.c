/* One step of a controller: the commands of this instant, and its states one period T later.

   A sample is refused if it, a command or a state after it is not finite: commands and states remain unchanged, since a
   NaN would stay in the states forever. */

DM_EXPORT void dm_prepare(const double *p, double *c) { dm_constants(p, c); }

static int dm_finite(const double *values, int count) {
  double gap = 0;
  for (int k = 0; k < count; k++) gap += values[k] - values[k];
  return gap == 0;
}

/* Returns 0 if the sample is refused. */
DM_EXPORT int dm_tick(double *z, const double *measured, const double *t, const double *T, const double *p,
                      const double *c, double *u) {
  double next[DM_Z + 1], command[DM_U + 1];
  if (!dm_finite(measured, DM_M) || !dm_finite(t, 1)) return 0;
  dm_control(z, measured, t, T, p, c, next, command);
  if (!dm_finite(next, DM_Z) || !dm_finite(command, DM_U)) return 0;
  memcpy(z, next, DM_Z * sizeof *z);
  memcpy(u, command, DM_U * sizeof *u);
  return 1;
}
