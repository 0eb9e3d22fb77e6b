/* Common part of both versions of FMI: an instance, its numbers, and its steps. The sizes and the functions of the model
   precede it; dm_begin and dm_advance of a controller or a robot, and the functions of one version follow.

   The order of numbers is inputs, outputs, parameters, states. Memory is allocated only for an instance or a saved state. */

/* Numbers that are not finite must be detected; with -ffast-math compilers assume that there are none. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)
#error "compile without -ffast-math and -ffinite-math-only"
#endif

#include <stdio.h>
#include <stdlib.h>

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* of the standard's functions */
#endif

#ifdef _WIN32
#define DM_API __declspec(dllexport)
#else
#define DM_API __attribute__((visibility("default")))
#endif

enum { DM_MADE, DM_INITIALISING, DM_STEPPING, DM_ENDED };
enum { DM_OK, DM_WARNING, DM_DISCARD, DM_ERROR };

typedef struct {
  double v[DM_V + 1], c[DM_C + 1];
  int mode, begun;
  double time; /* end of the last step */
} dm_kept;

typedef struct {
  dm_kept now;
  char *name;
  void *logger, *environment;
  int logging;
} dm_instance;

static int dm_begin(dm_kept *k, double t);   /* initialise the states */
static int dm_advance(dm_kept *k, double t); /* advance one sample; both return 0 for numbers that are not finite */

static void dm_log(const dm_instance *it, const char *text); /* log an error */

static int dm_fail(const dm_instance *it, const char *text) {
  dm_log(it, text);
  return DM_ERROR;
}

static int dm_sound(const double *values, size_t count) {
  double gap = 0;
  for (size_t k = 0; k < count; k++) gap += values[k] - values[k];
  return gap == 0;
}

static void dm_restart(dm_instance *it) {
  memset(&it->now, 0, sizeof it->now);
  memcpy(it->now.v, dm_values, DM_V * sizeof *dm_values);
}

static dm_instance *dm_make(const char *name, const char *token, void *logger, void *environment, int logging) {
  dm_instance *it = calloc(1, sizeof *it);
  if (it == NULL) return NULL;
  it->logger = logger;
  it->environment = environment;
  it->logging = logging;
  it->name = calloc(strlen(name) + 1, 1);
  if (it->name == NULL || strcmp(token, DM_TOKEN) != 0) {
    if (it->name != NULL) strcpy(it->name, name);
    dm_log(it, "the token is not that of this FMU: its description belongs to another");
    free(it->name);
    free(it);
    return NULL;
  }
  strcpy(it->name, name);
  dm_restart(it);
  return it;
}

static void dm_free(dm_instance *it) {
  if (it == NULL) return;
  free(it->name);
  free(it);
}

/* Inputs may be set at any time, parameters and states until the first step, outputs never. */
static int dm_may_set(const dm_instance *it, size_t first, size_t count) {
  if (first + count > DM_V) return 0;
  if (first + count <= DM_INPUTS) return 1;
  return first >= DM_INPUTS + DM_OUTPUTS && it->now.mode != DM_STEPPING && it->now.mode != DM_ENDED;
}

static int dm_write(dm_instance *it, size_t first, size_t count, const double *values) {
  if (!dm_may_set(it, first, count)) return dm_fail(it, "expected an input, or before the first step a parameter or state");
  if (!dm_sound(values, count)) return dm_fail(it, "expected finite numbers");
  memcpy(it->now.v + first, values, count * sizeof *values);
  if (first >= DM_INPUTS + DM_OUTPUTS) it->now.begun = 0;
  return DM_OK;
}

/* Initialise the model, when its inputs are set. */
static int dm_started(dm_instance *it, double t) {
  if (it->now.begun) return 1;
  dm_constants(it->now.v + DM_INPUTS + DM_OUTPUTS, it->now.c);
  it->now.begun = dm_begin(&it->now, t);
  return it->now.begun;
}

static int dm_read(dm_instance *it, size_t first, size_t count, double *values) {
  if (first + count > DM_V) return dm_fail(it, "expected a reference of modelDescription.xml");
  if (DM_SHOWS && it->now.mode != DM_MADE && !dm_started(it, it->now.time))
    return dm_fail(it, "the initial values are not finite");
  memcpy(values, it->now.v + first, count * sizeof *values);
  return DM_OK;
}

static int dm_do_step(dm_instance *it, double t, double h) {
  const double ticks = round(t / DM_PERIOD);
  if (it->now.mode != DM_STEPPING) return dm_fail(it, "expected to be initialised before the first step");
  if (!(fabs(h - DM_PERIOD) <= 1e-9 * DM_PERIOD && fabs(t - ticks * DM_PERIOD) <= 1e-6 * DM_PERIOD)) /* NaN, too */
    return dm_fail(it, "expected steps of one sampling period each, from time 0 on: " DM_PERIOD_TEXT " s");
  if (!(fabs(t - it->now.time) <= 1e-6 * DM_PERIOD))
    return dm_fail(it, "expected a step from where the last one ended, or a saved state to begin from");
  /* the time of a sample is its number times the period, since sums of periods would drift */
  if (!dm_started(it, ticks * DM_PERIOD) || !dm_advance(&it->now, ticks * DM_PERIOD))
    return dm_fail(it, "a sample or a result is not finite");
  it->now.time = (ticks + 1) * DM_PERIOD;
  return DM_OK;
}

/* Save a state, and allocate it if needed. */
static int dm_keep(const dm_instance *it, const void *from, void **state) {
  if (*state == NULL) *state = malloc(sizeof(dm_kept));
  if (*state == NULL) return dm_fail(it, "there is no memory for a saved state");
  memcpy(*state, from, sizeof(dm_kept));
  return DM_OK;
}

static int dm_drop(void **state) {
  free(*state);
  *state = NULL;
  return DM_OK;
}

static int dm_serialize(const dm_instance *it, const void *state, void *bytes, size_t size) {
  if (size < sizeof(dm_kept)) return dm_fail(it, "expected room for the whole state");
  memcpy(bytes, state, sizeof(dm_kept));
  return DM_OK;
}

static int dm_deserialize(const dm_instance *it, const void *bytes, size_t size, void **state) {
  if (size != sizeof(dm_kept)) return dm_fail(it, "expected a state that this FMU has saved");
  return dm_keep(it, bytes, state);
}

/* A function of the standard, with the parameters given after its name, that is not supported. */
#define DM_REFUSED(text, function, ...) \
  DM_API int function(__VA_ARGS__) { return dm_fail(c, text); }

/* Functions of saved states of both versions. */
#define DM_SAVED_STATES(fmi, state_word, deserialize, byte)                                                              \
  DM_API int fmi##Get##state_word(void *c, void **state) { return dm_keep(c, &((dm_instance *)c)->now, state); }         \
  DM_API int fmi##Set##state_word(void *c, void *state) {                                                                \
    memcpy(&((dm_instance *)c)->now, state, sizeof(dm_kept));                                                            \
    return DM_OK;                                                                                                        \
  }                                                                                                                      \
  DM_API int fmi##Free##state_word(void *c, void **state) { return dm_drop(state); }                                     \
  DM_API int fmi##Serialized##state_word##Size(void *c, void *state, size_t *size) {                                     \
    *size = sizeof(dm_kept);                                                                                             \
    return DM_OK;                                                                                                        \
  }                                                                                                                      \
  DM_API int fmi##Serialize##state_word(void *c, void *state, byte bytes[], size_t size) {                               \
    return dm_serialize(c, state, bytes, size);                                                                          \
  }                                                                                                                      \
  DM_API int fmi##deserialize##state_word(void *c, const byte bytes[], size_t size, void **state) {                      \
    return dm_deserialize(c, bytes, size, state);                                                                        \
  }
