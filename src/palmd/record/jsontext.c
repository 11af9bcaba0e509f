/* Numbers as JSON: the shortest decimal that reads back as the same double, formatted as Python's repr does.

   Schubfach (Giulietti, The Schubfach way to render doubles, 2021): the shortest and nearest decimal that rounds to x is
   one of the two or four neighbours of x on the coarsest grids. NaN and infinities become null. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define LEAST_POWER (-292)
#define POWERS 617
#define PLACEHOLDER '\1'

const long jsontext_powers[2] = {LEAST_POWER, POWERS};

typedef unsigned __int128 Wide;

typedef struct {
  uint64_t high, low;
} Power; /* 10^k scaled to 128 bits (leading bit 2^127), rounded up */

typedef struct {
  uint64_t digits;
  int exponent;
} Decimal;

static int floor_log2_of_power(int k) { return (k * 1741647) >> 19; }

static uint64_t to_odd(Power g, uint64_t c) {
  const Wide x = (Wide)g.low * c, y = (Wide)g.high * c + (uint64_t)(x >> 64);
  return (uint64_t)(y >> 64) | ((uint64_t)y > 1);
}

static Decimal shortest(const Power *powers, uint64_t fraction, int exponent) {
  const uint64_t c = exponent ? fraction | (uint64_t)1 << 52 : fraction;
  const int q = (exponent ? exponent : 1) - 1075;
  if (q <= 0 && q > -53 && !(c & (((uint64_t)1 << -q) - 1))) return (Decimal){c >> -q, 0}; /* whole */
  const int closer = !fraction && exponent > 1; /* the next double below is half as far as the one above */
  const int k = (q * 1262611 - (closer ? 524031 : 0)) >> 22;
  const int shift = q + floor_log2_of_power(-k) + 1;
  const Power g = powers[-k - LEAST_POWER];
  const uint64_t odd = c & 1;
  const uint64_t lower = to_odd(g, (4 * c - 2 + closer) << shift) + odd;
  const uint64_t at = to_odd(g, 4 * c << shift);
  const uint64_t upper = to_odd(g, (4 * c + 2) << shift) - odd;
  const uint64_t s = at / 4;
  if (s >= 10) {
    const uint64_t tens = s / 10;
    const int below = lower <= 40 * tens, above = 40 * tens + 40 <= upper;
    if (below != above) return (Decimal){tens + above, k + 1};
  }
  const int below = lower <= 4 * s, above = 4 * s + 4 <= upper;
  if (below != above) return (Decimal){s + above, k};
  const uint64_t middle = 4 * s + 2;
  return (Decimal){s + (at > middle || (at == middle && s & 1)), k};
}

static char *number(const Power *powers, double x, char *out) {
  uint64_t bits;
  memcpy(&bits, &x, sizeof bits);
  if (!isfinite(x)) return memcpy(out, "null", 4), out + 4;
  if (bits >> 63) *out++ = '-';
  if (x == 0.0) return memcpy(out, "0.0", 3), out + 3;
  Decimal decimal = shortest(powers, bits & (((uint64_t)1 << 52) - 1), (int)(bits >> 52 & 0x7ff));
  while (decimal.digits % 10 == 0) decimal.digits /= 10, decimal.exponent++;
  char text[20];
  int count = 0;
  for (uint64_t left = decimal.digits; left; left /= 10) text[sizeof text - ++count] = (char)('0' + left % 10);
  const char *digits = text + sizeof text - count;
  const int point = count + decimal.exponent; /* digits before the point */
  if (point > 16 || point < -3) {
    *out++ = *digits;
    if (count > 1) *out++ = '.', memcpy(out, digits + 1, (size_t)(count - 1)), out += count - 1;
    int power = point - 1;
    *out++ = 'e', *out++ = power < 0 ? '-' : '+';
    if (power < 0) power = -power;
    if (power > 99) *out++ = (char)('0' + power / 100);
    *out++ = (char)('0' + power / 10 % 10), *out++ = (char)('0' + power % 10);
    return out;
  }
  if (point <= 0) {
    memcpy(out, "0.000", 5);
    out += 2 - point;
    return memcpy(out, digits, (size_t)count), out + count;
  }
  const int before = count < point ? count : point;
  memcpy(out, digits, (size_t)before), out += before;
  for (int i = before; i < point; i++) *out++ = '0';
  *out++ = '.';
  if (count <= point) return *out++ = '0', out;
  return memcpy(out, digits + point, (size_t)(count - point)), out + count - point;
}

/* Copy `length` bytes of `text` to `out`, replacing each PLACEHOLDER by the next of `numbers` (at most 25 bytes each);
   returns the length of the output. */
long jsontext_fill(const Power *powers, const char *text, long length, const double *numbers, char *out) {
  char *end = out;
  for (const char *stop = text + length; text < stop; text++) {
    if (*text == PLACEHOLDER)
      end = number(powers, *numbers++, end);
    else
      *end++ = *text;
  }
  return (long)(end - out);
}
