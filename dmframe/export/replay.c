/* Holds this controller to the samples of a simulation: commands and states must have the same bits.

   Numbers follow the order of the operations in the source, where a compiler keeps to it: no fused multiply-add
   (-ffp-contract=off), and no loops turned into vectors (-fno-tree-vectorize), which fuses them all the same in some. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "DM_FILE.h"
#include "samples.h"

static double apart(const double *found, const double *expected, size_t count) {
  double most = 0;
  for (size_t k = 0; k < count; k++) most = fmax(most, fabs(found[k] - expected[k]) / (1 + fabs(expected[k])));
  return most;
}

/* All samples from the first on; what is commanded goes to `commands`, the last state to `state`. */
int dm_replay(const double *measured, const double *times, double *commands, double *state) {
  DM_FILE_controller controller;
  DM_FILE_measured from;
  DM_FILE_commanded to;
  DM_FILE_init(&controller, &DM_FILE_defaults);
  for (size_t k = 0; k < DM_SAMPLES; k++) {
    memcpy(&from, measured + k * DM_MEASURED, sizeof from);
    if (k == 0 && !DM_FILE_reset(&controller, &from, times[0])) return 0;
    if (!DM_FILE_step(&controller, &from, times[k], &to)) return 0;
    memcpy(commands + k * DM_COMMANDED, &to, sizeof to);
  }
  memcpy(state, controller.state, sizeof controller.state);
  return 1;
}

#ifndef DM_NO_MAIN
int main(void) {
  static double commands[DM_SAMPLES * DM_COMMANDED], state[sizeof dm_state / sizeof *dm_state];
  if (!dm_replay(dm_measured, dm_times, commands, state)) return puts("a sample was refused"), 1;
  const int same = !memcmp(commands, dm_commands, sizeof dm_commands) && !memcmp(state, dm_state, sizeof dm_state);
  const double most = fmax(apart(commands, dm_commands, sizeof dm_commands / sizeof *dm_commands),
                           apart(state, dm_state, sizeof dm_state / sizeof *dm_state));
  printf("DM_FILE: %d samples, %s; largest relative difference %.2g\n", DM_SAMPLES,
         same ? "the same bits" : "other bits", most);
  return DM_EXACT ? !same : !(most < 1e-9);
}
#endif
