/* Compares this controller with the samples of a simulation. Each sample begins from the state of the reference, so that a
   difference does not propagate to the next: commands and the state after a sample must have the same bits.

   This requires a compiler that keeps the order of operations: without fused multiply-add (-ffp-contract=off), and without
   vectorisation (-fno-tree-vectorize), which fuses them nevertheless in some compilers. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "DM_FILE.h"
#include "samples.h"

enum { DM_OTHER, DM_NEAR, DM_SAME };

/* Compute one sample and replace the state by the next; 0 if the sample is refused. */
static int dm_one(DM_FILE_controller *controller, double *state, const double *measured, double t, double *commands) {
  DM_FILE_measured from;
  DM_FILE_commanded to;
  memcpy(&from, measured, sizeof from);
  memcpy(controller->state, state, DM_STATES * sizeof *state);
  if (!DM_FILE_step(controller, &from, t, &to)) return 0;
  memcpy(commands, &to, sizeof to);
  memcpy(state, controller->state, DM_STATES * sizeof *state);
  return 1;
}

/* Compute all samples: commands, the state before each and after the last, and the number of accepted samples. */
void dm_chain(const double *measured, const double *times, double *commands, double *states, double *taken) {
  DM_FILE_controller controller;
  DM_FILE_measured from;
  *taken = -1;
  DM_FILE_init(&controller, &DM_FILE_defaults);
  memcpy(&from, measured, sizeof from);
  if (!DM_FILE_reset(&controller, &from, times[0])) return;
  memcpy(states, controller.state, DM_STATES * sizeof *states);
  for (*taken = 0; *taken < DM_SAMPLES; *taken += 1, states += DM_STATES, commands += DM_COMMANDED) {
    memcpy(states + DM_STATES, states, DM_STATES * sizeof *states);
    if (!dm_one(&controller, states + DM_STATES, measured, *times, commands)) return;
    measured += DM_MEASURED, times++;
  }
}

#ifndef DM_NO_MAIN
static double dm_most; /* largest difference, relative to 1 + |number| */

static int dm_compared(const double *found, const double *expected, size_t count) {
  double most = 0;
  for (size_t k = 0; k < count; k++) most = fmax(most, fabs(found[k] - expected[k]) / (1 + fabs(expected[k])));
  if (most < 1e-9) dm_most = fmax(dm_most, most);
  return !memcmp(found, expected, count * sizeof *found) ? DM_SAME : most < 1e-9 ? DM_NEAR : DM_OTHER;
}

static int dm_worse(int a, int b) { return a < b ? a : b; }

/* Perturb numbers by at most `units` in the last place. */
static void dm_moved(double *to, const double *from, size_t count, int units, uint32_t *seed) {
  for (size_t k = 0; k < count; k++) {
    *seed = *seed * 1664525u + 1013904223u;
    to[k] = from[k] * (1 + DBL_EPSILON * ((int)(*seed >> 16) % (2 * units + 1) - units));
  }
}

/* Compare sample k with perturbed inputs with the reference. */
static int dm_sampled(DM_FILE_controller *controller, size_t k, int units, uint32_t seed) {
  double state[DM_STATES + 1], measured[DM_MEASURED], commands[DM_COMMANDED];
  dm_moved(state, dm_state + k * DM_STATES, DM_STATES, units, &seed);
  dm_moved(measured, dm_measured + k * DM_MEASURED, DM_MEASURED, units, &seed);
  if (!dm_one(controller, state, measured, dm_times[k], commands)) return DM_OTHER;
  return dm_worse(dm_compared(commands, dm_commands + k * DM_COMMANDED, DM_COMMANDED),
                  dm_compared(state, dm_state + (k + 1) * DM_STATES, DM_STATES));
}

int main(void) {
  DM_FILE_controller controller;
  DM_FILE_measured from;
  int all, switched = 0;
  DM_FILE_init(&controller, &DM_FILE_defaults);
  memcpy(&from, dm_measured, sizeof from);
  if (!DM_FILE_reset(&controller, &from, dm_times[0])) return puts("DM_FILE: the start was refused"), 1;
  all = dm_compared(controller.state, dm_state, DM_STATES);
  for (size_t k = 0; k < DM_SAMPLES; k++) {
    int found = dm_sampled(&controller, k, 0, 0);
    /* if rounding decides a switch, perturbed inputs reach the reference's side of it */
    for (uint32_t seed = 1; found == DM_OTHER && seed <= 64 && !DM_EXACT; seed++) {
      found = dm_sampled(&controller, k, 4, seed) == DM_OTHER ? DM_OTHER : DM_NEAR;
      switched += found == DM_NEAR;
    }
    if (found == DM_OTHER) printf("DM_FILE: sample %d, from the state of the reference: different numbers\n", (int)k);
    all = dm_worse(all, found);
  }
  printf("DM_FILE: %d samples, %s; largest relative difference %.2g\n", DM_SAMPLES,
         all == DM_SAME ? "the same bits" : "different bits", dm_most);
  if (switched > 0) printf("DM_FILE: at %d of them rounding decides a switch\n", switched);
  return DM_EXACT ? all != DM_SAME : all == DM_OTHER;
}
#endif
