/* Arithmetic on several runs at once: each number is a vector with an element per run, as wide as the machine's registers.
   Sine, cosine and tanh do the same operations as those of arithmetic.h; functions without a vector form are computed run by
   run. */

#if defined(__AVX512F__)
#define DM_WIDTH 8
#define DM_FILLED(x) x, x, x, x, x, x, x, x
#elif defined(__AVX__)
#define DM_WIDTH 4
#define DM_FILLED(x) x, x, x, x
#else
#define DM_WIDTH 2
#define DM_FILLED(x) x, x
#endif

typedef double dm_real __attribute__((vector_size(8 * DM_WIDTH)));
typedef int64_t dm_mask __attribute__((vector_size(8 * DM_WIDTH)));
typedef uint64_t dm_bits __attribute__((vector_size(8 * DM_WIDTH)));

/* A comparison of vectors is a mask: all bits of an element are set, or none. */
static inline dm_real dm_all(double x) { return (dm_real){DM_FILLED(x)}; }
static inline dm_real dm_where(dm_mask yes, dm_real x) { return (dm_real)(yes & (dm_mask)x); }
static inline dm_real dm_choose(dm_mask yes, dm_real x, dm_real y) { return (dm_real)((yes & (dm_mask)x) | (~yes & (dm_mask)y)); }
static inline dm_real dm_truth(dm_mask yes) { return dm_where(yes, dm_all(1)); }
static inline int dm_any(dm_mask yes) {
  int64_t found = 0;
  for (int i = 0; i < DM_WIDTH; i++) found |= yes[i];
  return found != 0;
}

/* Integrator steps of each run in a tick; their maximum; and the value `next` in the run's own steps, else `rest`. */
typedef dm_mask dm_steps;
static inline int64_t dm_most(dm_steps substeps) {
  int64_t most = substeps[0];
  for (int i = 1; i < DM_WIDTH; i++) most = substeps[i] > most ? substeps[i] : most;
  return most;
}
static inline dm_real dm_before(int64_t j, dm_steps substeps, dm_real next, dm_real rest) {
  return dm_choose(j < substeps, next, rest);
}

static inline dm_real dm_abs(dm_real x) { return (dm_real)((dm_mask)x & INT64_MAX); }

static inline void dm_sincos_simd(dm_real x, dm_real *sine, dm_real *cosine) {
  const double shift = 0x1.8p52;
  const dm_real turns = x * 0.63661977236758134308 + shift, n = turns - shift;
  const dm_real r = ((x - n * 0x1.921fb54400000p+0) - n * 0x1.0b4611a600000p-34) - n * 0x1.3198a2e037073p-69;
  const dm_bits quarter = (dm_bits)turns;
  const dm_real y = r * r, y2 = y * y, y4 = y2 * y2;
  const dm_real s = r + r * y * ((-1.0 / 6 + y * (1.0 / 120)) + y2 * (-1.0 / 5040 + y * (1.0 / 362880))
      + y4 * ((-1.0 / 39916800 + y * (1.0 / 6227020800.0)) - y2 * (1.0 / 1307674368000.0)));
  const dm_real c = (1 - 0.5 * y) + y2 * ((1.0 / 24 - y * (1.0 / 720)) + y2 * (1.0 / 40320 - y * (1.0 / 3628800))
      + y4 * ((1.0 / 479001600 - y * (1.0 / 87178291200.0)) + y2 * (1.0 / 20922789888000.0)));
  const dm_mask odd = -(dm_mask)(quarter & 1);
  const dm_real a = dm_choose(odd, c, s), b = dm_choose(odd, s, c);
  *sine = (dm_real)((dm_bits)a ^ ((quarter & 2) << 62));
  *cosine = (dm_real)((dm_bits)b ^ (((quarter + 1) & 2) << 62));
  const dm_mask far = ~(dm_mask)(dm_abs(x) < 1e5); /* NaN, too */
  if (dm_any(far))
    for (int i = 0; i < DM_WIDTH; i++)
      if (far[i]) (*sine)[i] = sin(x[i]), (*cosine)[i] = cos(x[i]);
}

static inline dm_real dm_tanh_simd(dm_real x) {
  const dm_real a = dm_abs(x), y = dm_choose(a > 20, dm_all(40), 2 * a);
  const double shift = 0x1.8p52;
  const dm_real steps = y * 1.44269504088896340736 + shift, n = steps - shift;
  const dm_real r = (y - n * 0x1.62e42fefa3800p-1) - n * 0x1.ef35793c76730p-45;
  const dm_real scale = (dm_real)(((dm_bits)steps + 1023) << 52);
  const dm_real r2 = r * r, r4 = r2 * r2, r8 = r4 * r4;
  const dm_real q = r + r2 * (((0.5 + r * (1.0 / 6)) + r2 * (1.0 / 24 + r * (1.0 / 120)))
      + r4 * ((1.0 / 720 + r * (1.0 / 5040)) + r2 * (1.0 / 40320 + r * (1.0 / 362880)))
      + r8 * ((1.0 / 3628800 + r * (1.0 / 39916800)) + r2 * (1.0 / 479001600 + r * (1.0 / 6227020800.0))));
  const dm_real e = scale * q + (scale - 1), t = e / (e + 2);
  return (dm_real)(((dm_mask)t & INT64_MAX) | ((dm_mask)x & INT64_MIN));
}

static inline dm_real dm_sign_simd(dm_real x) {
  return dm_choose(x > 0, dm_all(1), dm_choose(x < 0, dm_all(-1), x));
}
static inline dm_real dm_fmin_simd(dm_real x, dm_real y) { return dm_choose((x < y) | (y != y), x, y); }
static inline dm_real dm_fmax_simd(dm_real x, dm_real y) { return dm_choose((x > y) | (y != y), x, y); }

#define DM_RUN_BY_RUN(f) \
  static inline dm_real dm_##f##_simd(dm_real x) { \
    dm_real y; \
    for (int i = 0; i < DM_WIDTH; i++) y[i] = f(x[i]); \
    return y; \
  }
#define DM_RUN_BY_RUN_2(f) \
  static inline dm_real dm_##f##_simd(dm_real x, dm_real y) { \
    dm_real z; \
    for (int i = 0; i < DM_WIDTH; i++) z[i] = f(x[i], y[i]); \
    return z; \
  }
DM_RUN_BY_RUN(exp) DM_RUN_BY_RUN(log) DM_RUN_BY_RUN(sqrt) DM_RUN_BY_RUN(tan) DM_RUN_BY_RUN(asin) DM_RUN_BY_RUN(acos)
DM_RUN_BY_RUN(atan) DM_RUN_BY_RUN(floor) DM_RUN_BY_RUN(ceil) DM_RUN_BY_RUN(erf) DM_RUN_BY_RUN(sinh) DM_RUN_BY_RUN(cosh)
DM_RUN_BY_RUN(asinh) DM_RUN_BY_RUN(acosh) DM_RUN_BY_RUN(atanh) DM_RUN_BY_RUN(log1p) DM_RUN_BY_RUN(expm1)
DM_RUN_BY_RUN_2(pow) DM_RUN_BY_RUN_2(fmod) DM_RUN_BY_RUN_2(copysign) DM_RUN_BY_RUN_2(atan2) DM_RUN_BY_RUN_2(hypot)
DM_RUN_BY_RUN_2(remainder)
