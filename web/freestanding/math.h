/* The mathematics of C that touch.h and touch_encode.h need, where there is no library: instructions, the browser's
   functions, and a few that library.c computes. What reaches a decoder is whole numbers; these decide the choices of the
   encoder, and the last product of a decoded force is exact. */
#ifndef TOUCH_WASM_MATH_H
#define TOUCH_WASM_MATH_H
#define sqrt __builtin_sqrt
#define floor __builtin_floor
#define ceil __builtin_ceil
#define fabs __builtin_fabs
#define rint __builtin_rint
#define sqrtf __builtin_sqrtf
#define fabsf __builtin_fabsf
#define HUGE_VAL __builtin_huge_val()
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
#define TOUCH_FROM_PAGE(name) __attribute__((import_module("page"), import_name(name)))
TOUCH_FROM_PAGE("sin") double sin(double x);
TOUCH_FROM_PAGE("cos") double cos(double x);
TOUCH_FROM_PAGE("atan") double atan(double x);
TOUCH_FROM_PAGE("atan2") double atan2(double y, double x);
TOUCH_FROM_PAGE("asin") double asin(double x);
TOUCH_FROM_PAGE("log2") double log2(double x);
TOUCH_FROM_PAGE("acos") double acos(double x);
TOUCH_FROM_PAGE("exp") double exp(double x);
TOUCH_FROM_PAGE("expm1") double expm1(double x);
TOUCH_FROM_PAGE("pow") double pow(double x, double y);
double fmod(double x, double y);
#define isnan(x) __builtin_isnan(x)
#define isfinite(x) __builtin_isfinite(x)
static inline double fmax(double x, double y) { return x > y || isnan(y) ? x : y; }
static inline double fmin(double x, double y) { return x < y || isnan(y) ? x : y; }
double ldexp(double x, int power);
double frexp(double x, int *power);
#endif
