/* The few functions of C's library that touch.h and touch_encode.h need; blocks of memory are copied and filled by instructions. */
#include "math.h"
#include "string.h"

void *memcpy(void *to, const void *from, size_t n) { return __builtin_memcpy(to, from, n); }

void *memmove(void *to, const void *from, size_t n) { return __builtin_memmove(to, from, n); }

void *memset(void *to, int value, size_t n) { return __builtin_memset(to, value, n); }

int memcmp(const void *a, const void *b, size_t n) {
    const unsigned char *p = a, *q = b;
    for (; n; n--, p++, q++)
        if (*p != *q) return *p < *q ? -1 : 1;
    return 0;
}

size_t strlen(const char *text) {
    size_t n = 0;
    while (text[n]) n++;
    return n;
}

double ldexp(double x, int power) {
    for (; power > 0; power--) x *= 2;
    for (; power < 0; power++) x /= 2;
    return x;
}

/* x = out * 2^power with 0.5 <= |out| < 1; zero, infinities and what is no number stay, with power 0. */
double frexp(double x, int *power) {
    unsigned long long bits;
    int exponent;
    *power = 0;
    memcpy(&bits, &x, 8), exponent = (int)(bits >> 52 & 2047);
    if (x == 0 || exponent == 2047) return x;
    if (!exponent) { /* below the smallest normal number */
        x = frexp(x * 0x1p64, power), *power -= 64;
        return x;
    }
    *power = exponent - 1022, bits = (bits & ~(2047ull << 52)) | 1022ull << 52;
    memcpy(&x, &bits, 8);
    return x;
}

/* The rest of x / y, exact: what is subtracted is between half of the rest and the rest. */
double fmod(double x, double y) {
    double rest = fabs(x), size = fabs(y), step;
    if (!(size > 0) || !(rest < HUGE_VAL)) return __builtin_nan("");
    while (rest >= size) {
        for (step = size; step <= 0.5 * rest;) step *= 2;
        rest -= step;
    }
    return x < 0 ? -rest : rest;
}
