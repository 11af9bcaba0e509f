/* Arithmetic of the kernels: a `lane` is one double (LANES 1) or a vector register of WIDE columns, in GNU C vectors.
   Compilers keep intermediate results of wider vectors in memory, which is many times slower.

   Only additions, multiplications, divisions, roots and bit operations, none of them contracted: one column gives the
   same bits as eight, on any processor. sin, cos, exp, log and atan are fdlibm's (Sun Microsystems 1993), within an ulp
   or two of libm's; the angle's last bits are dropped, and beyond MOST_ANGLE the result is NaN.

   Define LANES before including it, and include it once per translation unit. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline, unused))

#if LANES == 1
#define WIDE 1
typedef double lane;
typedef int64_t mask;
#define EVERY(value) (value)
#define TEST(comparison) (-(mask)(comparison))
#else
#ifdef __AVX512F__
#define WIDE 8
#else
#define WIDE 4
#endif
_Static_assert(LANES % WIDE == 0, "columns fill registers");
typedef double lane __attribute__((vector_size(8 * WIDE)));
typedef int64_t mask __attribute__((vector_size(8 * WIDE)));
#define EVERY(value) ((value) - (lane){0})
#define TEST(comparison) ((mask)(comparison))
#endif

#define MOST_ANGLE 1e6

INLINE mask bits(lane a) { mask m; memcpy(&m, &a, sizeof m); return m; }
INLINE lane real(mask m) { lane a; memcpy(&a, &m, sizeof a); return a; }
INLINE lane either(mask test, lane yes, lane no) { return real((bits(yes) & test) | (bits(no) & ~test)); }
INLINE lane load(const double *from) { lane a; memcpy(&a, from, sizeof a); return a; }
INLINE void store(double *to, lane a) { memcpy(to, &a, sizeof a); }

#if LANES == 1
INLINE lane gather(const double *from, long stride) { (void)stride; return *from; }
INLINE void scatter(double *to, long stride, lane a) { (void)stride; *to = a; }
#define EACH(f, a) f(a)
#define EACH2(f, a, b) f(a, b)
#else
/* Written out, since unrolling loops needs an optimisation level that doubles the compile time. */
#define FOUR(of, l, ...) of(l, __VA_ARGS__), of(l + 1, __VA_ARGS__), of(l + 2, __VA_ARGS__), of(l + 3, __VA_ARGS__)
#if WIDE == 8
#define ALL(of, ...) FOUR(of, 0, __VA_ARGS__), FOUR(of, 4, __VA_ARGS__)
#else
#define ALL(of, ...) FOUR(of, 0, __VA_ARGS__)
#endif
#define TAKEN(l, from, n) from[(l) * n]
#define PUT(l, to, n, a) to[(l) * n] = a[l]
#define OF_ONE(l, f, a) f(a[l])
#define OF_TWO(l, f, a, b) f(a[l], b[l])
INLINE lane gather(const double *from, long n) { return (lane){ALL(TAKEN, from, n)}; }
INLINE void scatter(double *to, long n, lane a) { ALL(PUT, to, n, a); }
#define EACH(f, a) ({ lane a_ = (a); (lane){ALL(OF_ONE, f, a_)}; })
#define EACH2(f, a, b) ({ lane a_ = (a), b_ = (b); (lane){ALL(OF_TWO, f, a_, b_)}; })
#endif

/* truth is 1.0 or 0.0, as in CasADi */
INLINE lane truth(mask test) { return real(bits(EVERY(1.0)) & test); }
INLINE lane if_else_zero(lane test, lane a) { return real(bits(a) & TEST(test != 0.0)); }
INLINE lane not_(lane a) { return truth(TEST(a == 0.0)); }
INLINE lane and_(lane a, lane b) { return truth(TEST(a != 0.0) & TEST(b != 0.0)); }
INLINE lane or_(lane a, lane b) { return truth(TEST(a != 0.0) | TEST(b != 0.0)); }
INLINE lane abs_(lane a) { return real(bits(a) & INT64_MAX); }
INLINE lane min_(lane a, lane b) { return either(TEST(a < b) | TEST(b != b), a, b); }
INLINE lane max_(lane a, lane b) { return either(TEST(a > b) | TEST(b != b), a, b); }
INLINE lane root(lane a) { return EACH(sqrt, a); }

#define MAGIC 6755399441055744.0 /* 1.5 2^52: a number added to it is rounded to an integer, in the lowest bits */

INLINE lane floor_(lane a) { /* |a| < 2^51 */
  lane nearest = (a + MAGIC) - MAGIC;
  return nearest - truth(TEST(nearest > a));
}

INLINE void sin_cos(lane x, lane *sine, lane *cosine) {
  lane whole = x * 6.36619772367581382433e-01 + MAGIC, k = whole - MAGIC;
  mask n = bits(whole);
  lane r = ((x - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
  r = either(TEST(abs_(x) < MOST_ANGLE), r, EVERY(NAN));
  lane z = r * r;
  lane s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
         + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  lane half = 0.5 * z, near = 1.0 - half;
  lane c = near + (((1.0 - near) - half) + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
         + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
         + z * -1.13596475577881948265e-11))))));
  mask swap = -(n & 1);
  *sine = real(bits(either(swap, c, s)) ^ (n & 2) << 62);
  *cosine = real(bits(either(swap, s, c)) ^ ((n + 1) & 2) << 62);
}

INLINE lane power_of_two(mask k) { return real((k + 1023) << 52); }

INLINE lane exp_(lane x) {
  lane inside = min_(max_(x, EVERY(-746.0)), EVERY(710.0)); /* beyond these bounds the result rounds to 0 or infinity */
  lane whole = inside * 1.44269504088896338700e+00 + MAGIC, k = whole - MAGIC;
  mask n = bits(whole) - bits(EVERY(MAGIC));
  lane high = inside - k * 6.93147180369123816490e-01, low = k * 1.90821492927058770002e-10, r = high - low, t = r * r;
  lane c = r - t * (1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * (6.61375632143793436117e-05
         + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08))));
  lane y = 1.0 - ((low - r * c / (2.0 - c)) - high);
  mask half = n >> 1;
  return either(TEST(x == x), y * power_of_two(half) * power_of_two(n - half), x);
}

INLINE lane log_(lane x) {
  lane tiny = truth(TEST(x < 2.2250738585072014e-308)), scaled = x * (1.0 + tiny * 18014398509481983.0); /* 2^54 */
  mask m = bits(scaled), n = ((m - 0x3fe6a09e667f3bcd) >> 52) ; /* so that the mantissa is in [sqrt(1/2), sqrt(2)) */
  lane f = real(m - (n << 52)) - 1.0;
  lane k = (real(bits(EVERY(MAGIC)) + n) - MAGIC) - 54.0 * tiny;
  lane s = f / (2.0 + f), z = s * s, w = z * z;
  lane odd = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
  lane even = z * (6.666666666666735130e-01 + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01
            + w * 1.479819860511658591e-01)));
  lane half = 0.5 * f * f;
  lane y = k * 6.93147180369123816490e-01 - ((half - (s * (half + odd + even) + k * 1.90821492927058770002e-10)) - f);
  y = either(TEST(x == 0.0), EVERY(-INFINITY), either(TEST(x == INFINITY), x, y));
  return either(TEST(x >= 0.0), y, EVERY(NAN));
}

/* atan x = base + atan t with |t| < 7/16, t = (x - c) / (1 + c x) for the c = 0, 1/2, 1, 3/2 or infinity nearest to |x| */
INLINE lane atan_(lane x) {
  lane a = abs_(x), over = a, under = EVERY(1.0), high = EVERY(0.0), low = EVERY(0.0);
#define FROM(least, numerator, denominator, base, rest) { \
    mask beyond = TEST(a >= least); \
    over = either(beyond, numerator, over), under = either(beyond, denominator, under); \
    high = either(beyond, EVERY(base), high), low = either(beyond, EVERY(rest), low); }
  FROM(0.4375, 2.0 * a - 1.0, 2.0 + a, 4.63647609000806093515e-01, 2.26987774529616870924e-17)
  FROM(0.6875, a - 1.0, a + 1.0, 7.85398163397448278999e-01, 3.06161699786838301793e-17)
  FROM(1.1875, a - 1.5, 1.0 + 1.5 * a, 9.82793723247329054082e-01, 1.39033110312309984516e-17)
  FROM(2.4375, EVERY(-1.0), a, 1.57079632679489655800e+00, 6.12323399573676603587e-17)
#undef FROM
  lane t = over / under, z = t * t, w = z * z;
  lane even = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02
            + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
  lane odd = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02
           + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
  lane y = high - ((t * (even + odd) - low) - t);
  return either(TEST(x == x), real(bits(y) | (bits(x) & INT64_MIN)), x);
}
