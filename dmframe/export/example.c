/* Example of a control loop. Replace the robot: fill DM_FILE_measured from yours, and send DM_FILE_commanded to it. */
#include <stdio.h>

#include "DM_FILE.h"

/* Stationary robot; replace it by yours. */
static void read_robot(DM_FILE_measured *measured) { *measured = (DM_FILE_measured){DM_STILL}; }

static void command_robot(const DM_FILE_commanded *commanded) {
  const double *value = (const double *)commanded;
  for (size_t k = 0; k < sizeof *commanded / sizeof *value; k++) printf(" % .6f", value[k]);
  printf("\n");
}

int main(void) {
  static DM_FILE_controller controller;
  DM_FILE_measured measured;
  DM_FILE_commanded commanded;

  DM_FILE_init(&controller, &DM_FILE_defaults);
  read_robot(&measured);
  if (!DM_FILE_reset(&controller, &measured, 0.0)) return 1; /* a number was not finite: do not move */
  for (int k = 0; k < 5; k++) {
    /* wait for the robot's next sample here; use the robot's time, not a count of loops */
    read_robot(&measured);
    if (!DM_FILE_step(&controller, &measured, k * DM_PERIOD, &commanded)) return 1; /* stop the robot */
    command_robot(&commanded);
  }
  return 0;
}
