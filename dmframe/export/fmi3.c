/* FMI 3.0 for co-simulation, with the names and types of the standard. A reference is that of an array; 0 is the time. */
#include <stdbool.h>

typedef void (*dm_logger)(void *environment, int status, const char *category, const char *text);
typedef const char *dm_text;
typedef void (*dm_update)(void *, double, bool, bool, bool, bool, bool *, double *);

static void dm_log(const dm_instance *it, const char *text) {
  dm_logger logger;
  memcpy(&logger, &it->logger, sizeof logger);
  if (logger != NULL) logger(it->environment, DM_ERROR, "logStatusError", text);
}

DM_API const char *fmi3GetVersion(void) { return "3.0"; }

DM_API int fmi3SetDebugLogging(void *c, bool on, size_t count, const dm_text categories[]) {
  ((dm_instance *)c)->logging = on;
  return DM_OK;
}

DM_API void *fmi3InstantiateModelExchange(dm_text name, dm_text token, dm_text resources, bool visible, bool logging,
                                          void *environment, dm_logger logger) {
  return NULL;
}

DM_API void *fmi3InstantiateScheduledExecution(dm_text name, dm_text token, dm_text resources, bool visible, bool logging,
                                               void *environment, dm_logger logger, void (*update)(void *),
                                               void (*lock)(void), void (*unlock)(void)) {
  return NULL;
}

DM_API void *fmi3InstantiateCoSimulation(dm_text name, dm_text token, dm_text resources, bool visible, bool logging,
                                         bool events, bool early, const uint32_t wanted[], size_t count,
                                         void *environment, dm_logger logger, dm_update update) {
  void *kept = NULL;
  if (name == NULL || token == NULL || events || count > 0) return NULL;
  memcpy(&kept, &logger, sizeof kept);
  return dm_make(name, token, kept, environment, logging);
}

DM_API void fmi3FreeInstance(void *c) { dm_free(c); }

DM_API int fmi3EnterInitializationMode(void *c, bool tolerated, double tolerance, double start, bool stops, double stop) {
  ((dm_instance *)c)->now.time = start;
  ((dm_instance *)c)->now.mode = DM_INITIALISING;
  return DM_OK;
}

DM_API int fmi3ExitInitializationMode(void *c) {
  ((dm_instance *)c)->now.mode = DM_STEPPING;
  return DM_OK;
}

DM_REFUSED("there are no events", fmi3EnterEventMode, void *c)
DM_REFUSED("there are no events", fmi3EnterStepMode, void *c)
DM_REFUSED("there are no events", fmi3EvaluateDiscreteStates, void *c)
DM_REFUSED("there are no structural parameters", fmi3EnterConfigurationMode, void *c)
DM_REFUSED("there are no structural parameters", fmi3ExitConfigurationMode, void *c)

DM_API int fmi3Terminate(void *c) {
  ((dm_instance *)c)->now.mode = DM_ENDED;
  return DM_OK;
}

DM_API int fmi3Reset(void *c) {
  dm_restart(c);
  return DM_OK;
}

/* Read, or with `write` set, all arrays of a call. */
static int dm_moved(dm_instance *it, const uint32_t at[], size_t count, double *values, size_t room, int write) {
  for (size_t k = 0; k < count; k++) {
    if (at[k] > DM_VARIABLES) return dm_fail(it, "expected a reference of modelDescription.xml");
    const size_t first = at[k] == 0 ? 0 : dm_variables[at[k] - 1].first, size = at[k] == 0 ? 1 : dm_variables[at[k] - 1].size;
    if (size > room) return dm_fail(it, "expected as many values as the arrays have");
    if (at[k] == 0 && write) return dm_fail(it, "the time is not set");
    if (at[k] == 0) *values = it->now.time;
    else if ((write ? dm_write(it, first, size, values) : dm_read(it, first, size, values)) != DM_OK) return DM_ERROR;
    values += size;
    room -= size;
  }
  return room == 0 ? DM_OK : dm_fail(it, "expected as many values as the arrays have");
}

DM_API int fmi3GetFloat64(void *c, const uint32_t at[], size_t count, double values[], size_t room) {
  return dm_moved(c, at, count, values, room, 0);
}

DM_API int fmi3SetFloat64(void *c, const uint32_t at[], size_t count, const double values[], size_t room) {
  double copy[DM_V + 1];
  if (room > DM_V) return dm_fail(c, "expected as many values as the arrays have");
  memcpy(copy, values, room * sizeof *values);
  return dm_moved(c, at, count, copy, room, 1);
}

/* All variables are of type Float64. */
#define DM_NO_VARIABLES(type, word)                                                                                    \
  DM_API int fmi3Get##word(void *c, const uint32_t at[], size_t count, type values[], size_t room) {                    \
    return count + room == 0 ? DM_OK : dm_fail(c, "there are no variables of type " #word);                             \
  }                                                                                                                     \
  DM_API int fmi3Set##word(void *c, const uint32_t at[], size_t count, const type values[], size_t room) {              \
    return count + room == 0 ? DM_OK : dm_fail(c, "there are no variables of type " #word);                             \
  }
DM_NO_VARIABLES(float, Float32)
DM_NO_VARIABLES(int8_t, Int8)
DM_NO_VARIABLES(uint8_t, UInt8)
DM_NO_VARIABLES(int16_t, Int16)
DM_NO_VARIABLES(uint16_t, UInt16)
DM_NO_VARIABLES(int32_t, Int32)
DM_NO_VARIABLES(uint32_t, UInt32)
DM_NO_VARIABLES(int64_t, Int64)
DM_NO_VARIABLES(uint64_t, UInt64)
DM_NO_VARIABLES(bool, Boolean)
DM_NO_VARIABLES(dm_text, String)

DM_API int fmi3GetBinary(void *c, const uint32_t at[], size_t count, size_t sizes[], const uint8_t *values[], size_t room) {
  return count + room == 0 ? DM_OK : dm_fail(c, "there are no variables of type Binary");
}

DM_API int fmi3SetBinary(void *c, const uint32_t at[], size_t count, const size_t sizes[], const uint8_t *const values[],
                         size_t room) {
  return count + room == 0 ? DM_OK : dm_fail(c, "there are no variables of type Binary");
}

DM_API int fmi3GetClock(void *c, const uint32_t at[], size_t count, bool values[]) {
  return count == 0 ? DM_OK : dm_fail(c, "there are no clocks");
}

DM_API int fmi3SetClock(void *c, const uint32_t at[], size_t count, const bool values[]) {
  return count == 0 ? DM_OK : dm_fail(c, "there are no clocks");
}

DM_SAVED_STATES(fmi3, FMUState, Deserialize, uint8_t)

DM_REFUSED("dependencies are not available", fmi3GetNumberOfVariableDependencies, void *c, uint32_t at, size_t *count)
DM_REFUSED("dependencies are not available", fmi3GetVariableDependencies, void *c, uint32_t at, size_t mine[],
           uint32_t others[], size_t theirs[], int kinds[], size_t count)
DM_REFUSED("derivatives are not available", fmi3GetDirectionalDerivative, void *c, const uint32_t unknown[],
           size_t unknowns, const uint32_t known[], size_t knowns, const double seed[], size_t seeds, double out[],
           size_t outs)
DM_REFUSED("derivatives are not available", fmi3GetAdjointDerivative, void *c, const uint32_t unknown[], size_t unknowns,
           const uint32_t known[], size_t knowns, const double seed[], size_t seeds, double out[], size_t outs)
DM_REFUSED("derivatives are not available", fmi3GetOutputDerivatives, void *c, const uint32_t at[], size_t count,
           const int32_t orders[], double values[], size_t room)

#define DM_NO_CLOCK(function, ...) DM_REFUSED("there are no clocks", function, void *c, const uint32_t at[], size_t count, __VA_ARGS__)
DM_NO_CLOCK(fmi3GetIntervalDecimal, double intervals[], int kinds[])
DM_NO_CLOCK(fmi3GetIntervalFraction, uint64_t counters[], uint64_t parts[], int kinds[])
DM_NO_CLOCK(fmi3GetShiftDecimal, double shifts[])
DM_NO_CLOCK(fmi3GetShiftFraction, uint64_t counters[], uint64_t parts[])
DM_NO_CLOCK(fmi3SetIntervalDecimal, const double intervals[])
DM_NO_CLOCK(fmi3SetIntervalFraction, const uint64_t counters[], const uint64_t parts[])
DM_NO_CLOCK(fmi3SetShiftDecimal, const double shifts[])
DM_NO_CLOCK(fmi3SetShiftFraction, const uint64_t counters[], const uint64_t parts[])

DM_API int fmi3UpdateDiscreteStates(void *c, bool *more, bool *ends, bool *nominals, bool *values, bool *timed, double *next) {
  *more = *ends = *nominals = *values = *timed = false;
  return dm_fail(c, "there are no events");
}

DM_API int fmi3DoStep(void *c, double t, double h, bool settled, bool *events, bool *ends, bool *early, double *last) {
  *events = *ends = *early = false;
  const int status = dm_do_step(c, t, h);
  *last = ((dm_instance *)c)->now.time;
  return status;
}

/* Functions of the other two kinds of simulation, which some tools look up by name. */
#define DM_OTHER_KIND(...) DM_REFUSED("expected co-simulation", __VA_ARGS__)
DM_OTHER_KIND(fmi3EnterContinuousTimeMode, void *c)
DM_OTHER_KIND(fmi3SetTime, void *c, double t)
DM_OTHER_KIND(fmi3SetContinuousStates, void *c, const double x[], size_t n)
DM_OTHER_KIND(fmi3GetContinuousStateDerivatives, void *c, double dx[], size_t n)
DM_OTHER_KIND(fmi3GetEventIndicators, void *c, double z[], size_t n)
DM_OTHER_KIND(fmi3GetContinuousStates, void *c, double x[], size_t n)
DM_OTHER_KIND(fmi3GetNominalsOfContinuousStates, void *c, double x[], size_t n)
DM_OTHER_KIND(fmi3GetNumberOfEventIndicators, void *c, size_t *n)
DM_OTHER_KIND(fmi3GetNumberOfContinuousStates, void *c, size_t *n)
DM_OTHER_KIND(fmi3ActivateModelPartition, void *c, uint32_t clock, double t)
DM_OTHER_KIND(fmi3CompletedIntegratorStep, void *c, bool settled, bool *event, bool *ends)
