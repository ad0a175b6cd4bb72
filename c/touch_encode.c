/* Compiles encoder and decoder to a shared library: cc -O2 -shared -fPIC -o libtouch.so touch_encode.c -lm */
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"
