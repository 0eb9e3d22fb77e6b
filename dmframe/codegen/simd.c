/* DM_WIDTH runs at a time, as loop.c computes one; included after integrate.c. Only figures of each run are kept: for each of
   its DM_Y outputs the sum of squares in each eighth of the run, the least, the largest and the last value, and the time at
   which its absolute value first exceeded a limit. */

#define DM_PARTS 8
#define DM_S (DM_Z + DM_X)

/* Figures of one output. */
typedef struct {
  dm_real squares[DM_PARTS], least, most, last, crossed;
} dm_figures;

/* Update the figures of the runs that have not diverged, at time t in the given eighth of the run. */
static void dm_keep(dm_figures *all, const dm_real *y, const double *limits, double t, int part, dm_mask alive) {
  for (int j = 0; j < DM_Y; j++) {
    dm_figures *f = all + j;
    const dm_real v = y[j];
    f->squares[part] += dm_where(alive, v * v);
    f->least = dm_choose(alive & (v < f->least), v, f->least);
    f->most = dm_choose(alive & (v > f->most), v, f->most);
    f->last = dm_choose(alive, v, f->last);
    f->crossed = dm_choose(alive & (dm_abs(v) > limits[j]) & (f->crossed < 0), dm_all(t), f->crossed);
  }
}

DM_EXPORT void dm_width(double *count) { *count = DM_WIDTH; }

/* Ticks first to first + ticks - 1 of DM_WIDTH runs; the run is the last index of every array. `given` has a row per tick, as
   for dm_run, and `part` is the eighth in which the row is recorded, or -1. One more row, after these ticks, only updates
   figures, if it is recorded. When a run leaves its bounds, `ended` is set to that tick (-1 before), and the run restarts from
   `begin` without being recorded: non-finite numbers would slow down the others. Returns how many runs have not diverged. */
DM_EXPORT int64_t dm_run_simd(const double *begin, double *state, const double *p, double period, const int64_t *substeps,
                               int64_t first, int64_t ticks, const double *given, const int64_t *part,
                               const double *limits, const double *bounds, double *figures, int64_t *ended) {
  dm_work k;
  dm_real x[DM_S + 1], fresh[DM_S + 1], values[DM_P + 1], n[DM_N + 1];
  dm_figures all[DM_Y + 1];
  dm_mask left;
  dm_steps steps;
  dm_real parts;
  const dm_real whole = dm_all(period);
  memcpy(x, state, DM_S * sizeof *x); /* vectors need an alignment that the caller's arrays may lack */
  memcpy(fresh, begin, DM_S * sizeof *x);
  memcpy(values, p, DM_P * sizeof *x);
  memcpy(all, figures, DM_Y * sizeof *all);
  memcpy(&left, ended, sizeof left);
  memcpy(&steps, substeps, sizeof steps);
  for (int i = 0; i < DM_WIDTH; i++) parts[i] = (double)steps[i];
  dm_mask alive = left < 0;
  dm_constants(values, k.c);
  for (int64_t tick = 0; tick <= ticks && dm_any(alive); tick++, given += 2 + DM_N, part++) {
    if (tick == ticks && *part < 0) break;
    const dm_real t = dm_all(given[0]);
    for (int i = 0; i < DM_N; i++) n[i] = dm_all(given[2 + i]);
    dm_trajectory(&t, values, k.c, k.w);
    dm_sample(x, k.w, n, &whole, values, k.c, k.z, k.u, k.y);
    if (*part >= 0) dm_keep(all, k.y, limits, given[0], *part, alive);
    if (tick == ticks) break;
    memcpy(x, k.z, DM_Z * sizeof *x);
    dm_integrate(x + DM_Z, given[0], given[1] / parts, steps, values, &k);
    dm_clip(x + DM_Z, values, k.c, x + DM_Z);
    dm_mask sound = alive;
    for (int i = 0; i < DM_S; i++) sound &= (dm_mask)(dm_abs(x[i]) <= bounds[i]);
    const dm_mask lost = alive & ~sound;
    left = (lost & (first + tick)) | (~lost & left);
    alive = sound;
    if (dm_any(~alive))
      for (int i = 0; i < DM_S; i++) x[i] = dm_choose(alive, x[i], fresh[i]);
  }
  memcpy(state, x, DM_S * sizeof *x);
  memcpy(figures, all, DM_Y * sizeof *all);
  memcpy(ended, &left, sizeof left);
  int64_t count = 0;
  for (int i = 0; i < DM_WIDTH; i++) count += alive[i] != 0;
  return count;
}
