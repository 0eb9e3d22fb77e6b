/* Simulation of one run: sampled states and the plant, or everything in continuous time (DM_Z is 0). integrate.c precedes
   this file. */

static void dm_log(const double *state, const dm_work *k, const int64_t *kept, int64_t columns, double *row) {
  for (int64_t j = 0; j < columns; j++)
    row[j] = kept[j] < DM_Z + DM_X ? state[kept[j]] : k->y[kept[j] - (DM_Z + DM_X)];
}

/* Compute the ticks first to first + ticks - 1. Each has a row of `given`: its time, its length, and its DM_N random
   numbers. At the start of every `every`th tick the `kept` numbers of (state, outputs) are written to a row of `log`.
   Returns the number of ticks that ended with a state within `bounds`; `state` is that after the last one. With 0 ticks,
   only the row of `first` is written. */
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
