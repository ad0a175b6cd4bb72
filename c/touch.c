/* Compiles the decoder, touch.h, to a shared library: cc -O2 -shared -fPIC -o libtouch.so touch.c -lm */
#define TOUCH_IMPLEMENTATION
#include "touch.h"
