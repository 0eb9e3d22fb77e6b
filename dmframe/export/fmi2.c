/* FMI 2.0 for co-simulation, with the names and types of the standard. */

typedef void (*dm_logger)(void *environment, const char *name, int status, const char *category, const char *text, ...);
typedef struct {
  dm_logger logger;
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void (*finished)(void *, int);
  void *environment;
} dm_callbacks;

static void dm_log(const dm_instance *it, const char *text) {
  dm_logger logger;
  memcpy(&logger, &it->logger, sizeof logger);
  if (logger != NULL) logger(it->environment, it->name == NULL ? "" : it->name, DM_ERROR, "logStatusError", "%s", text);
}

DM_API const char *fmi2GetTypesPlatform(void) { return "default"; }
DM_API const char *fmi2GetVersion(void) { return "2.0"; }

DM_API int fmi2SetDebugLogging(void *c, int on, size_t count, const char *const categories[]) {
  ((dm_instance *)c)->logging = on;
  return DM_OK;
}

DM_API void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
                             const dm_callbacks *callbacks, int visible, int logging) {
  void *logger = NULL;
  if (type != 1 || name == NULL || token == NULL) return NULL;
  if (callbacks != NULL) memcpy(&logger, &callbacks->logger, sizeof logger);
  return dm_make(name, token, logger, callbacks == NULL ? NULL : callbacks->environment, logging);
}

DM_API void fmi2FreeInstance(void *c) { dm_free(c); }

DM_API int fmi2SetupExperiment(void *c, int tolerated, double tolerance, double start, int stops, double stop) {
  ((dm_instance *)c)->now.time = start;
  return DM_OK;
}

DM_API int fmi2EnterInitializationMode(void *c) {
  ((dm_instance *)c)->now.mode = DM_INITIALISING;
  return DM_OK;
}

DM_API int fmi2ExitInitializationMode(void *c) {
  ((dm_instance *)c)->now.mode = DM_STEPPING;
  return DM_OK;
}

DM_API int fmi2Terminate(void *c) {
  ((dm_instance *)c)->now.mode = DM_ENDED;
  return DM_OK;
}

DM_API int fmi2Reset(void *c) {
  dm_restart(c);
  return DM_OK;
}

DM_API int fmi2GetReal(void *c, const unsigned at[], size_t count, double values[]) {
  for (size_t k = 0; k < count; k++)
    if (dm_read(c, at[k], 1, values + k) != DM_OK) return DM_ERROR;
  return DM_OK;
}

DM_API int fmi2SetReal(void *c, const unsigned at[], size_t count, const double values[]) {
  for (size_t k = 0; k < count; k++)
    if (dm_write(c, at[k], 1, values + k) != DM_OK) return DM_ERROR;
  return DM_OK;
}

/* All variables are of type Real. */
#define DM_NO_VARIABLES(type, word)                                                                     \
  DM_API int fmi2Get##word(void *c, const unsigned at[], size_t count, type values[]) {                 \
    return count == 0 ? DM_OK : dm_fail(c, "there are no variables of type " #word);                    \
  }                                                                                                     \
  DM_API int fmi2Set##word(void *c, const unsigned at[], size_t count, const type values[]) {           \
    return count == 0 ? DM_OK : dm_fail(c, "there are no variables of type " #word);                    \
  }
typedef const char *dm_text;
DM_NO_VARIABLES(int, Integer)
DM_NO_VARIABLES(int, Boolean)
DM_NO_VARIABLES(dm_text, String)

DM_SAVED_STATES(fmi2, FMUstate, DeSerialize, char)

DM_REFUSED("derivatives are not available", fmi2GetDirectionalDerivative, void *c, const unsigned unknown[],
           size_t unknowns, const unsigned known[], size_t knowns, const double seed[], double out[])
DM_REFUSED("inputs are constant during a step", fmi2SetRealInputDerivatives, void *c, const unsigned at[], size_t count,
           const int order[], const double values[])
DM_REFUSED("derivatives are not available", fmi2GetRealOutputDerivatives, void *c, const unsigned at[], size_t count,
           const int order[], double values[])

DM_API int fmi2DoStep(void *c, double t, double h, int settled) {
  return dm_do_step(c, t, h);
}

DM_REFUSED("a step is done when its call returns", fmi2CancelStep, void *c)

DM_API int fmi2GetStatus(void *c, int kind, int *value) {
  return dm_fail(c, "a step is done when its call returns") == DM_ERROR ? DM_DISCARD : DM_OK;
}

DM_API int fmi2GetRealStatus(void *c, int kind, double *value) {
  if (kind != 2) return DM_DISCARD;
  *value = ((dm_instance *)c)->now.time;
  return DM_OK;
}

DM_API int fmi2GetIntegerStatus(void *c, int kind, int *value) { return DM_DISCARD; }

DM_API int fmi2GetBooleanStatus(void *c, int kind, int *value) {
  if (kind != 3) return DM_DISCARD;
  *value = 0;
  return DM_OK;
}

DM_API int fmi2GetStringStatus(void *c, int kind, dm_text *value) { return DM_DISCARD; }
