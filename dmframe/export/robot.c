/* FMU of a robot and its servo: constant commands between samples, RK4 integration. */

static double *dm_states(dm_kept *k) { return k->v + DM_INPUTS + DM_OUTPUTS + DM_P; }
static const double *dm_numbers(const dm_kept *k) { return k->v + DM_INPUTS + DM_OUTPUTS; }

static int dm_show(dm_kept *k) {
  double shown[DM_OUTPUTS];
  dm_measured(dm_states(k), dm_numbers(k), k->c, shown);
  if (!dm_sound(shown, DM_OUTPUTS)) return 0;
  memcpy(k->v + DM_INPUTS, shown, DM_OUTPUTS * sizeof *shown);
  return 1;
}

static int dm_begin(dm_kept *k, double t) {
  (void)t;
  return dm_show(k);
}

static void dm_slope(dm_kept *k, const double *x, double *dx) { dm_rate(x, k->v, dm_numbers(k), k->c, dx); }

static int dm_advance(dm_kept *k, double t) {
  const double h = DM_PERIOD / DM_SUBSTEPS;
  double k1[DM_Z], k2[DM_Z], k3[DM_Z], k4[DM_Z], at[DM_Z], x[DM_Z];
  (void)t;
  memcpy(x, dm_states(k), sizeof x);
  for (int j = 0; j < DM_SUBSTEPS; j++) {
    dm_slope(k, x, k1);
    for (int i = 0; i < DM_Z; i++) at[i] = x[i] + h / 2 * k1[i];
    dm_slope(k, at, k2);
    for (int i = 0; i < DM_Z; i++) at[i] = x[i] + h / 2 * k2[i];
    dm_slope(k, at, k3);
    for (int i = 0; i < DM_Z; i++) at[i] = x[i] + h * k3[i];
    dm_slope(k, at, k4);
    for (int i = 0; i < DM_Z; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  }
  if (!dm_sound(x, DM_Z) || !dm_sound(k->v, DM_INPUTS)) return 0;
  memcpy(dm_states(k), x, sizeof x);
  return dm_show(k);
}
