/* Interface of the controller, over the functions of the graph's equations. No memory is allocated, only the arguments are
   read and written, and the control flow depends only on the graph's switches. */

/* Numbers that are not finite must be detected; with -ffast-math compilers assume that there are none. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "compile without -ffast-math and -ffinite-math-only"
#endif

typedef char dm_measured_is_packed[sizeof(DM_NAMED(measured)) == DM_M * sizeof(double) ? 1 : -1];
typedef char dm_commanded_is_packed[sizeof(DM_NAMED(commanded)) == DM_U * sizeof(double) ? 1 : -1];
typedef char dm_path_is_packed[sizeof(DM_NAMED(path)) >= DM_W * sizeof(double) ? 1 : -1];
typedef char dm_parameters_are_packed[sizeof(DM_NAMED(parameters)) == DM_P * sizeof(double) ? 1 : -1];

static int dm_finite(const double *values, int count) {
  double gap = 0;
  for (int k = 0; k < count; k++) gap += values[k] - values[k];
  return gap == 0;
}

static int dm_read(const DM_NAMED(measured) * from, double t, double *measured) {
  memcpy(measured, from, DM_M * sizeof *measured);
  return dm_finite(measured, DM_M) && dm_finite(&t, 1);
}

void DM_NAMED(init)(DM_NAMED(controller) * self, const DM_NAMED(parameters) * parameters) {
  memset(self, 0, sizeof *self);
  memcpy(self->parameters, parameters, DM_P * sizeof *self->parameters);
  dm_constants(self->parameters, self->constants);
}

int DM_NAMED(reset)(DM_NAMED(controller) * self, const DM_NAMED(measured) * from, double t) {
  double measured[DM_M], state[DM_Z + 1];
  const double T = DM_PERIOD;
  state[DM_Z] = 0;
  if (!dm_read(from, t, measured)) return 0;
  dm_start(measured, &t, &T, self->parameters, self->constants, state);
  if (!dm_finite(state, DM_Z)) return 0;
  memcpy(self->state, state, DM_Z * sizeof *state);
  self->refused = 0;
  return 1;
}

void DM_NAMED(path_at)(const DM_NAMED(controller) * self, double t, double T, DM_NAMED(path) * to) {
  double path[DM_W + 1];
  path[DM_W] = 0;
  dm_path(&t, &T, self->parameters, self->constants, path);
  memcpy(to, path, DM_W * sizeof *path);
}

int DM_NAMED(step_on)(DM_NAMED(controller) * self, const DM_NAMED(measured) * from, const DM_NAMED(path) * on, double t,
                      double T, DM_NAMED(commanded) * to) {
  double measured[DM_M], path[DM_W + 1], next[DM_Z + 1], command[DM_U];
  next[DM_Z] = path[DM_W] = 0;
  memcpy(path, on, DM_W * sizeof *path);
  if (dm_read(from, t, measured) && dm_finite(&T, 1) && dm_finite(path, DM_W)) {
    dm_follow(self->state, measured, &t, &T, path, self->parameters, self->constants, next, command);
    if (dm_finite(next, DM_Z) && dm_finite(command, DM_U)) {
      memcpy(self->state, next, DM_Z * sizeof *next);
      memcpy(to, command, DM_U * sizeof *command);
      return 1;
    }
  }
  self->refused++;
  return 0;
}

int DM_NAMED(step_for)(DM_NAMED(controller) * self, const DM_NAMED(measured) * from, double t, double T,
                       DM_NAMED(commanded) * to) {
  DM_NAMED(path) path;
  DM_NAMED(path_at)(self, t, T, &path);
  return DM_NAMED(step_on)(self, from, &path, t, T, to);
}

int DM_NAMED(step)(DM_NAMED(controller) * self, const DM_NAMED(measured) * from, double t, DM_NAMED(commanded) * to) {
  return DM_NAMED(step_for)(self, from, t, DM_PERIOD, to);
}
