/* A run in plain C: what samples move, over the plant, or everything in continuous time (then DM_Z is 0). Above this
   stand integrate.c and what is above that. */

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
