/* Single run: a number is a double. */

typedef double dm_real;
static inline dm_real dm_all(double x) { return x; }

/* Integrator steps in a tick; and the value `next` in these steps, else `rest`. */
typedef int64_t dm_steps;
static inline int64_t dm_most(dm_steps substeps) { return substeps; }
static inline dm_real dm_before(int64_t j, dm_steps substeps, dm_real next, dm_real rest) {
  return j < substeps ? next : rest; /* always next */
}
