/* The decoder as a library: cc -O2 -shared -fPIC -o libtouch.so touch.c -lm */
#define TOUCH_IMPLEMENTATION
#include "touch.h"
