/* One step of a controller: the commands of this instant, and its states one period T later. */

DM_EXPORT void dm_prepare(const double *p, double *c) { dm_constants(p, c); }

DM_EXPORT void dm_tick(double *z, const double *measured, const double *t, const double *T, const double *p,
                       const double *c, double *u) {
  double next[DM_Z + 1];
  dm_control(z, measured, t, T, p, c, next, u);
  memcpy(z, next, DM_Z * sizeof *z);
}
