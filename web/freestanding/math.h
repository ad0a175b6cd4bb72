/* What touch.h asks of the mathematics of C, where there is no library: two are instructions, three the browser's. */
#ifndef TOUCH_WASM_MATH_H
#define TOUCH_WASM_MATH_H
#define sqrt __builtin_sqrt
#define floor __builtin_floor
#define ceil __builtin_ceil
#define fabs __builtin_fabs
#define sqrtf __builtin_sqrtf
#define TOUCH_FROM_PAGE(name) __attribute__((import_module("page"), import_name(name)))
TOUCH_FROM_PAGE("sin") double sin(double x);
TOUCH_FROM_PAGE("cos") double cos(double x);
TOUCH_FROM_PAGE("atan") double atan(double x);
TOUCH_FROM_PAGE("atan2") double atan2(double y, double x);
double ldexp(double x, int power);
#endif
