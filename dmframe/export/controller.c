/* FMU of a controller: commands follow from the measurements at the beginning of a step. */

static double *dm_states(dm_kept *k) { return k->v + DM_INPUTS + DM_OUTPUTS + DM_P; }

/* Initialise the states from the first measurements. */
static int dm_begin(dm_kept *k, double t) {
  const double T = DM_PERIOD;
  double state[DM_Z + 1];
  state[DM_Z] = 0;
  dm_start(k->v, &t, &T, k->v + DM_INPUTS + DM_OUTPUTS, k->c, state);
  if (!dm_sound(k->v, DM_INPUTS) || !dm_sound(state, DM_Z)) return 0;
  memcpy(dm_states(k), state, DM_Z * sizeof *state);
  return 1;
}

static int dm_advance(dm_kept *k, double t) {
  const double T = DM_PERIOD;
  double next[DM_Z + 1], command[DM_OUTPUTS];
  next[DM_Z] = 0;
  dm_control(dm_states(k), k->v, &t, &T, k->v + DM_INPUTS + DM_OUTPUTS, k->c, next, command);
  if (!dm_sound(k->v, DM_INPUTS) || !dm_sound(next, DM_Z) || !dm_sound(command, DM_OUTPUTS)) return 0;
  memcpy(dm_states(k), next, DM_Z * sizeof *next);
  memcpy(k->v + DM_INPUTS, command, DM_OUTPUTS * sizeof *command);
  return 1;
}
