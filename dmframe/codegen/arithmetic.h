/* Sine, cosine and tanh to about one unit in the last place, short enough for a compiler to inline.
   Taylor series after argument reduction; the C library's functions for arguments out of the reduction's range. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

static inline void dm_sincos(double x, double *sine, double *cosine) {
  if (!(fabs(x) < 1e5)) { /* NaN, too */
    *sine = sin(x);
    *cosine = cos(x);
    return;
  }
  /* x = n pi/2 + r with |r| <= pi/4; pi/2 in three parts, of which n times the first two is exact */
  const double shift = 0x1.8p52, turns = x * 0.63661977236758134308 + shift, n = turns - shift;
  const double r = ((x - n * 0x1.921fb54400000p+0) - n * 0x1.0b4611a600000p-34) - n * 0x1.3198a2e037073p-69;
  uint64_t quarter;
  memcpy(&quarter, &turns, sizeof quarter);
  const double y = r * r, y2 = y * y, y4 = y2 * y2;
  const double s = r + r * y * ((-1.0 / 6 + y * (1.0 / 120)) + y2 * (-1.0 / 5040 + y * (1.0 / 362880))
      + y4 * ((-1.0 / 39916800 + y * (1.0 / 6227020800.0)) - y2 * (1.0 / 1307674368000.0)));
  const double c = (1 - 0.5 * y) + y2 * ((1.0 / 24 - y * (1.0 / 720)) + y2 * (1.0 / 40320 - y * (1.0 / 3628800))
      + y4 * ((1.0 / 479001600 - y * (1.0 / 87178291200.0)) + y2 * (1.0 / 20922789888000.0)));
  const double a = quarter & 1 ? c : s, b = quarter & 1 ? s : c;
  *sine = quarter & 2 ? -a : a;
  *cosine = (quarter + 1) & 2 ? -b : b;
}

static inline double dm_tanh(double x) {
  /* tanh |x| = e / (e + 2), e = exp(2 |x|) - 1 = 2^n (exp(r) - 1) + 2^n - 1, 2 |x| = n ln 2 + r; it is 1 from 20 on */
  const double a = fabs(x), y = a > 20 ? 40 : 2 * a;
  const double shift = 0x1.8p52, steps = y * 1.44269504088896340736 + shift, n = steps - shift;
  const double r = (y - n * 0x1.62e42fefa3800p-1) - n * 0x1.ef35793c76730p-45;
  uint64_t bits;
  memcpy(&bits, &steps, sizeof bits);
  bits = (bits + 1023) << 52;
  double scale;
  memcpy(&scale, &bits, sizeof scale);
  const double r2 = r * r, r4 = r2 * r2, r8 = r4 * r4;
  const double q = r + r2 * (((0.5 + r * (1.0 / 6)) + r2 * (1.0 / 24 + r * (1.0 / 120)))
      + r4 * ((1.0 / 720 + r * (1.0 / 5040)) + r2 * (1.0 / 40320 + r * (1.0 / 362880)))
      + r8 * ((1.0 / 3628800 + r * (1.0 / 39916800)) + r2 * (1.0 / 479001600 + r * (1.0 / 6227020800.0))));
  const double e = scale * q + (scale - 1);
  return copysign(e / (e + 2), x);
}

static inline double dm_sign(double x) { return x > 0 ? 1 : x < 0 ? -1 : x; }
static inline double dm_fmin(double x, double y) { return x < y || y != y ? x : y; }
static inline double dm_fmax(double x, double y) { return x > y || y != y ? x : y; }
