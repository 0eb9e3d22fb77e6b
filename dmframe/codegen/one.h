/* One run: a number is a double. */

typedef double dm_real;
static inline dm_real dm_all(double x) { return x; }
